"""Branches as textures in the layout of Unreal's Pivot Painter 2: a texel a branch, which vertices look up by UV set 1.

The layout is that of Epic's MAXScript and of its Blender add-on, in Unreal's axes and centimetres:

- position: halves; RGB is the pivot, alpha the parent's number plus 1,024, read as the bits of a half. A root names
  itself. `ms_PivotPainter2_UnpackIntegerAsFloat` undoes it.
- axis: bytes; RGB is the direction of the branch, (x + 1) / 2; alpha its length in steps of 8 cm,
  at most 256, over 256.
"""

import io

import numpy as np
from jaxtyping import Float32, Float64
from PIL import Image

from dynamictree.formats.gltf.writer import VERTEX_BUFFER, GlbWriter, write_glb
from dynamictree.formats.motion.exr import write_exr
from dynamictree.mesh import TriangleMesh
from dynamictree.rig.branch_pivots import BranchPivots

MESH, POSITION, DIRECTION = "tree-pivots.glb", "pivot-position-index.exr", "pivot-x-vector-extent.png"
PIVOT_PAINTER: dict[str, str | int] = {
    "mesh": MESH,
    "position_and_index": POSITION,
    "x_vector_and_extent": DIRECTION,
    "uv_set": 1,
}


def pivot_painter_files(mesh: TriangleMesh, pivots: BranchPivots) -> dict[str, bytes]:
    """The mesh at rest with the lookup as TEXCOORD_1, and both textures, by file name."""
    step_cm, most_steps = 8.0, 256
    first_index = 1024  # the least half that is not denormal
    count = len(pivots.foot_m)
    width = int(np.ceil(np.sqrt(count)))
    height = -(-count // width)
    axis, length_m = branch_axes(mesh, pivots)
    position = np.zeros((height * width, 4), np.float16)
    position[:count, :3] = _unreal(pivots.foot_m) * 100
    position[:, 3] = np.full(height * width, first_index, np.uint16).view(np.float16)
    position[:count, 3] = (pivots.parent + first_index).astype(np.uint16).view(np.float16)
    direction = np.zeros((height * width, 4), np.uint8)
    steps = np.clip(np.ceil(100 * length_m / step_cm), 1, most_steps)
    shares = np.column_stack([(_unreal(axis) + 1) / 2, steps / most_steps])
    direction[:count] = np.round(shares * 255)
    exr, png = io.BytesIO(), io.BytesIO()
    write_exr(position.reshape(height, width, 4), exr, channels="RGBA")
    Image.fromarray(direction.reshape(height, width, 4)).save(png, "PNG")
    column, row = pivots.branch % width, pivots.branch // width
    lookup = np.stack([(column + 0.5) / width, (row + 0.5) / height], axis=1).astype(np.float32)
    return {MESH: rest_glb(mesh, lookup), POSITION: exr.getvalue(), DIRECTION: png.getvalue()}


def branch_axes(
    mesh: TriangleMesh, pivots: BranchPivots
) -> tuple[Float64[np.ndarray, "E 3"], Float64[np.ndarray, " E"]]:
    """Direction from each branch's foot to the middle of its vertices, and how far they reach along it [m]."""
    count = len(pivots.foot_m)
    arm = mesh.vertices.astype(np.float64) - pivots.foot_m[pivots.branch]
    total = np.stack([np.bincount(pivots.branch, arm[:, side], count) for side in range(3)], axis=1)
    length = np.linalg.norm(total, axis=1, keepdims=True)
    axis = np.where(length > 0, total / np.maximum(length, 1e-12), np.array([0.0, 0.0, 1.0]))
    reach: Float64[np.ndarray, " E"] = np.zeros(count)
    np.maximum.at(reach, pivots.branch, np.einsum("nc,nc->n", arm, axis[pivots.branch]))
    return axis, reach


def _unreal(vectors: Float32[np.ndarray, "E 3"] | Float64[np.ndarray, "E 3"]) -> Float64[np.ndarray, "E 3"]:
    """From our axes to Unreal's: left-handed, +Z up, as its import turns a GLB."""
    turned: Float64[np.ndarray, "E 3"] = np.asarray(vectors, np.float64) * np.array([1.0, -1.0, 1.0])
    return turned


def rest_glb(mesh: TriangleMesh, lookup: Float32[np.ndarray, "N 2"]) -> bytes:
    """The mesh at rest in one node, with the lookup as TEXCOORD_1."""
    writer, stream = GlbWriter(), io.BytesIO()
    sets = {"TEXCOORD_1": lookup} | ({"TEXCOORD_0": np.zeros_like(lookup)} if mesh.look.uv is None else {})
    attributes = {name: writer.add_accessor(values, target=VERTEX_BUFFER) for name, values in sets.items()}
    write_glb(mesh, stream, writer, attributes)
    return stream.getvalue()
