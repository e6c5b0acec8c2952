"""A motion as a vertex animation texture, which engines play in the vertex shader, per instance.

A ZIP of `tree-rest.glb` (at rest; its last texture coordinates are the place of each vertex in the texture),
`displacement.exr` (half floats), `vat.json` and, if requested, `normal.exr` in the same layout. A frame takes
`rows_per_frame` rows of texels, frame 0 on top.

A texel is added to the position of a vertex: +Y up, metres.
"""

import json
import tempfile
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float16, Float32

from dynamictree.errors import InputError
from dynamictree.formats.gltf.writer import rest_glb
from dynamictree.mesh import TriangleMesh
from dynamictree.up_axis import up_rotation

VERSION = 3
MAX_SIDE = 8192  # texels; Unreal accepts it without further settings, and so does every desktop GPU


@dataclass(frozen=True, kw_only=True)
class TextureLayout:
    """Layout of vertices and frames: vertex n is at texel (n % width, frame · rows_per_frame + n // width)."""

    width: int
    rows_per_frame: int
    num_frames: int

    @property
    def height(self) -> int:
        """Rows of the texture."""
        return self.rows_per_frame * self.num_frames


def texture_layout(num_vertices: int, num_frames: int) -> TextureLayout:
    """Return the narrowest layout that is no higher than wide; its width is a power of two up to `MAX_SIDE`.

    Raises:
        InputError: the vertices and frames need a larger texture.
    """
    for width in (256, 512, 1024, 2048, 4096, MAX_SIDE):
        rows = -(-num_vertices // width)
        if rows * num_frames <= width or (width == MAX_SIDE and rows * num_frames <= MAX_SIDE):
            return TextureLayout(width=width, rows_per_frame=rows, num_frames=num_frames)
    allowed = MAX_SIDE * (MAX_SIDE // num_frames)
    raise InputError(
        f"a texture of {MAX_SIDE} x {MAX_SIDE} holds {allowed:,} vertices at {num_frames} frames; the mesh has "
        f"{num_vertices:,}: decimate it, or ask for fewer frames"
    )


def vertex_texture_files(
    mesh: TriangleMesh,
    frames: Iterable[Float32[np.ndarray, "N 3"]],
    *,
    num_frames: int,
    fps: float,
    loop: bool,
    normals: Iterable[Float32[np.ndarray, "N 3"]] | None = None,
) -> list[tuple[str, list[bytes]]]:
    """Return name and content of the archive's files; `frames` are displacements [m], `normals` unit normals per frame.

    Raises:
        InputError: the mesh and its frames do not fit into one texture.
    """
    layout = texture_layout(mesh.num_vertices, num_frames)
    texels = _texels(layout, frames)
    largest = np.abs(texels).max()
    facts = {
        "format": "vertex-animation-texture",
        "version": VERSION,
        "mesh": "tree-rest.glb",
        "texture": "displacement.exr",
        "num_vertices": mesh.num_vertices,
        "width": layout.width,
        "height": layout.height,
        "rows_per_frame": layout.rows_per_frame,
        "num_frames": num_frames,
        "fps": fps,
        "duration_s": num_frames / fps,
        "loop": loop,
        "lookup_attribute": "TEXCOORD_1",
        "lookup": "TEXCOORD_1 is a vertex' texel in frame 0; add frame * rows_per_frame / height to v",
        "space": "+Y up, metres",
        "max_displacement_m": float(largest),
        "half_float_error_m": float(np.spacing(largest)) / 2,  # largest error of a coordinate
    }
    files = [("displacement.exr", [exr_of(texels)])]
    if normals is not None:
        facts["normal_texture"] = "normal.exr"
        files.append(("normal.exr", [exr_of(_texels(layout, normals))]))
    row, column = np.divmod(np.arange(mesh.num_vertices), layout.width)  # the middle of each vertex's texel in frame 0
    lookup = np.stack([(column + 0.5) / layout.width, (row + 0.5) / layout.height], axis=1).astype(np.float32)
    rest = rest_glb(mesh, lookup)
    return [("vat.json", [json.dumps(facts, indent=1).encode()]), ("tree-rest.glb", [rest]), *files]


def _texels(layout: TextureLayout, frames: Iterable[Float32[np.ndarray, "N 3"]]) -> Float16[np.ndarray, "H W 3"]:
    """Return the texture of the vectors of all frames, in glTF's axes."""
    rotation = up_rotation("+Y").astype(np.float32)
    texels = np.zeros((layout.num_frames, layout.rows_per_frame * layout.width, 3), np.float16)
    for number, vectors in enumerate(frames):
        texels[number, : len(vectors)] = vectors @ rotation
    return texels.reshape(layout.height, layout.width, 3)


def exr_of(pixels: Float16[np.ndarray, "H W 3"]) -> bytes:
    """Encode a linear image, first row on top."""
    import OpenEXR  # 5 MB of code, loaded only on use

    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    with tempfile.TemporaryDirectory(prefix="dynamictree-exr-") as folder:
        path = Path(folder) / "picture.exr"
        with OpenEXR.File(header, {"RGB": np.ascontiguousarray(pixels)}) as picture:
            picture.write(str(path))
        return path.read_bytes()
