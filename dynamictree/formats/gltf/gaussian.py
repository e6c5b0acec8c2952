"""GLB files with KHR_gaussian_splatting: point primitives with rotation xyzw, linear scale, opacity and harmonics."""

from dataclasses import replace
from functools import reduce

import numpy as np
from jaxtyping import Float32, Float64

from dynamictree.errors import FormatError
from dynamictree.formats.axes import up_rotation
from dynamictree.formats.cloud_axes import to_source_axes, to_z_up, transformed
from dynamictree.formats.gltf.table import GlbFile, array, integer, listed, member, read_glb, write_glb
from dynamictree.formats.seekable import SeekableReader
from dynamictree.formats.splat.activations import scales_from_log
from dynamictree.formats.stream import ByteWriter
from dynamictree.gaussian.cloud import SH_DEGREES, GaussianCloud, check_count, validate_cloud
from dynamictree.gaussian.harmonics import SH_0
from dynamictree.gaussian.rotation import polar_rotations, quaternion_matrices, unit_quaternions

UP_AXIS = "+Y"
EXTENSION = "KHR_gaussian_splatting"
_POINTS = 0
_MAX_SHEAR = 1e-3  # of a node's scale; a Gaussian keeps its shape only under rotation and one scale
_MAX_DEPTH = 64  # nodes below one another


def read_gltf_gaussian(stream: SeekableReader, *, up_axis: str = UP_AXIS, unit_m: float = 1.0) -> GaussianCloud:
    """Read all splats of the default scene as one cloud, where their nodes place them.

    Raises:
        FormatError: not GLB, no splats in it, accessors outside of the file, a node that shears.
        InputError: values that are not finite, nothing visible, too many Gaussians.
    """
    glb = read_glb(stream)
    primitives = [
        (transform, primitive) for transform, mesh in _placed_meshes(glb) for primitive in _splats_of(glb, mesh)
    ]
    if not primitives:
        raise FormatError(f"the GLB file has no primitive with {EXTENSION} in its scene; it is no Gaussian splat")
    check_count(sum(_count(glb, primitive) for _, primitive in primitives))
    stored = [_read_primitive(glb, primitive) for _, primitive in primitives]
    if min(cloud.scales.min() for cloud in stored) < 0:  # a length is never negative: an early draft's logarithms
        stored = [replace(cloud, scales=scales_from_log(cloud.scales)) for cloud in stored]
    clouds = [_placed(cloud, transform) for cloud, (transform, _) in zip(stored, primitives, strict=True)]
    return to_z_up(validate_cloud(_joined(clouds)), up_axis=up_axis, unit_m=unit_m)


def write_gltf_gaussian(cloud: GaussianCloud, stream: ByteWriter) -> None:
    """Write one primitive of 32-bit floats, in the source's units and +Y up, as glTF demands."""
    rotation = up_rotation(UP_AXIS).T @ up_rotation(cloud.source_up_axis)
    source = transformed(to_source_axes(cloud), rotation, 1.0)
    attributes = {
        "POSITION": source.means,
        f"{EXTENSION}:ROTATION": source.quaternions[:, [1, 2, 3, 0]],
        f"{EXTENSION}:SCALE": source.scales,
        f"{EXTENSION}:OPACITY": source.opacity,
    } | {_harmonic_name(h): source.sh[:, h] for h in range(source.sh.shape[1])}
    extension = {
        "kernel": "ellipse",
        "colorSpace": "srgb_rec709_display",
        "projection": "perspective",
        "sortingMethod": "cameraDistance",
    }
    write_glb(attributes, {EXTENSION: extension}, stream)


def _splats_of(glb: GlbFile, mesh: int) -> list[dict[str, object]]:
    meshes = listed(glb.document, "meshes")
    if not 0 <= mesh < len(meshes):
        raise FormatError(f"a node of the GLB file names mesh {mesh} of {len(meshes)}")
    splats = [p for p in listed(meshes[mesh], "primitives") if EXTENSION in member(p, "extensions")]
    if any(integer(primitive, "mode", 4) != _POINTS for primitive in splats):
        raise FormatError(f"a primitive with {EXTENSION} is not of points (mode 0); the extension allows no other")
    return splats


def _count(glb: GlbFile, primitive: dict[str, object]) -> int:
    return glb.accessor_count(integer(member(primitive, "attributes"), "POSITION", -1))


def _read_primitive(glb: GlbFile, primitive: dict[str, object]) -> GaussianCloud:
    attributes = member(primitive, "attributes")
    count = _count(glb, primitive)

    def column(name: str, width: int) -> Float32[np.ndarray, "G width"]:
        if name not in attributes:
            raise FormatError(
                f"a splat of the GLB file has no attribute {name}; found are {', '.join(sorted(attributes))}"
            )
        values = glb.read_accessor(integer(attributes, name, -1))
        if values.shape != (count, width):
            raise FormatError(f"attribute {name} of the GLB file is {values.shape}; {(count, width)} is needed")
        return values

    num_harmonics = sum(1 for name in attributes if name.startswith(f"{EXTENSION}:SH_DEGREE_"))
    if num_harmonics not in SH_DEGREES:
        raise FormatError(f"a splat of the GLB file has {num_harmonics} harmonics; 1, 4, 9 or 16 are allowed")
    sh = np.stack([column(_harmonic_name(h), 3) for h in range(num_harmonics)], axis=1)
    extension = member(member(primitive, "extensions"), EXTENSION)
    if extension.get("colorSpace") == "lin_rec709_display":
        sh = _to_srgb(sh)
    return GaussianCloud(
        means=column("POSITION", 3),
        quaternions=unit_quaternions(column(f"{EXTENSION}:ROTATION", 4)[:, [3, 0, 1, 2]]),
        scales=column(f"{EXTENSION}:SCALE", 3),
        opacity=column(f"{EXTENSION}:OPACITY", 1)[:, 0],
        sh=sh,
    )


def _harmonic_name(index: int) -> str:
    degree = int(index**0.5)
    return f"{EXTENSION}:SH_DEGREE_{degree}_COEF_{index - degree**2}"


def _to_srgb(sh: Float32[np.ndarray, "G H 3"]) -> Float32[np.ndarray, "G H 3"]:
    """Linear colour to display colour: the mean exactly, what depends on the view to first order about it."""
    linear = np.clip(sh[:, 0] * SH_0 + 0.5, 0, 1).astype(np.float64)
    dark = linear <= 0.0031308
    mean = np.where(dark, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    slope = np.where(dark, 12.92, 1.055 / 2.4 * np.maximum(linear, 0.0031308) ** (1 / 2.4 - 1))
    return np.concatenate([((mean - 0.5) / SH_0)[:, None], sh[:, 1:] * slope[:, None]], axis=1).astype(np.float32)


def _placed_meshes(glb: GlbFile) -> list[tuple[Float64[np.ndarray, "4 4"], int]]:
    """Every mesh of the default scene with its place in the world."""
    nodes, scenes = listed(glb.document, "nodes"), listed(glb.document, "scenes")
    scene = integer(glb.document, "scene", 0)
    if not 0 <= scene < len(scenes):
        raise FormatError(f"the GLB file shows scene {scene} of {len(scenes)}; one scene is needed")
    placed = list[tuple[Float64[np.ndarray, "4 4"], int]]()
    pending = [(node, np.eye(4), 0) for node in reversed(array(scenes[scene], "nodes"))]  # a stack
    visited = set[int]()
    while pending:
        index, above, depth = pending.pop()
        if not (isinstance(index, int) and 0 <= index < len(nodes)) or index in visited or depth > _MAX_DEPTH:
            raise FormatError(f"the GLB file's nodes are no tree: node {index} is missing, met twice, or too deep")
        visited.add(index)
        node = nodes[index]
        transform = above @ _node_matrix(node)
        if "mesh" in node:
            placed.append((transform, integer(node, "mesh", -1)))
        pending += [(child, transform, depth + 1) for child in reversed(array(node, "children"))]
    return placed


def _node_matrix(node: dict[str, object]) -> Float64[np.ndarray, "4 4"]:
    def numbers(name: str, default: list[float]) -> Float64[np.ndarray, " numbers"]:
        found = array(node, name) if name in node else default
        if len(found) != len(default) or not all(isinstance(value, int | float) for value in found):
            raise FormatError(f"a node of the GLB file has {name} {str(found)[:80]}; {len(default)} numbers are needed")
        return np.array(found, np.float64)

    if "matrix" in node:
        return numbers("matrix", list(np.eye(4).ravel())).reshape(4, 4).T
    x, y, z, w = numbers("rotation", [0.0, 0.0, 0.0, 1.0])
    matrix = np.eye(4)
    matrix[:3, :3] = quaternion_matrices(np.array([[w, x, y, z]]))[0] * numbers("scale", [1.0, 1.0, 1.0])
    matrix[:3, 3] = numbers("translation", [0.0, 0.0, 0.0])
    return matrix


def _placed(cloud: GaussianCloud, transform: Float64[np.ndarray, "4 4"]) -> GaussianCloud:
    linear = transform[:3, :3]
    volume = float(np.linalg.det(linear))
    scale = float(np.cbrt(volume))
    rotation = polar_rotations(linear[None])[0]
    if not scale > 0 or np.abs(linear - scale * rotation).max() > _MAX_SHEAR * scale:
        raise FormatError(
            "a node of the GLB file mirrors, shears or stretches its splat; bake the transform into the splat"
        )
    turned = transformed(cloud, rotation, scale)
    return replace(turned, means=(turned.means + transform[:3, 3]).astype(np.float32))


def _joined(clouds: list[GaussianCloud]) -> GaussianCloud:
    """One cloud of the highest degree among them."""
    width = max(cloud.sh.shape[1] for cloud in clouds)
    widened = [np.pad(cloud.sh, ((0, 0), (0, width - cloud.sh.shape[1]), (0, 0))) for cloud in clouds]
    parts = {
        name: reduce(lambda a, b: np.concatenate([a, b]), [getattr(cloud, name) for cloud in clouds])
        for name in ("means", "quaternions", "scales", "opacity")
    }
    return replace(clouds[0], sh=np.concatenate(widened), **parts)
