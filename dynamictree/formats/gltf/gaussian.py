"""GLB files with KHR_gaussian_splatting: point primitives with rotation xyzw, linear scale, opacity and harmonics."""

from dataclasses import replace

import numpy as np
import scipy  # submodules load lazily, so the service starts without them
from jaxtyping import Float32, Float64

from dynamictree.byte_stream import ByteReader, ByteWriter, read_all
from dynamictree.color import linear_to_srgb, srgb_slope
from dynamictree.errors import FormatError
from dynamictree.formats.gltf.document import GltfDocument, accessor_layout, open_gltf
from dynamictree.formats.gltf.scene import mesh_instances
from dynamictree.formats.gltf.writer import GlbWriter
from dynamictree.formats.json_fields import JsonObject, index_field, integer_field, object_field, object_list
from dynamictree.formats.splat.activations import scales_from_log
from dynamictree.gaussian.axes import to_source_axes, transform_cloud
from dynamictree.gaussian.cloud import SH_DEGREES, GaussianCloud, check_count, join_clouds
from dynamictree.gaussian.harmonics import SH_0
from dynamictree.rotation import unit_quaternions

UP_AXIS = "+Y"
EXTENSION = "KHR_gaussian_splatting"
_POINTS = 0
MAX_FILE_BYTES = 3 << 30  # 10 million Gaussians of the third degree


def read_gltf_gaussian(stream: ByteReader) -> GaussianCloud:
    """Read all splats of the default scene as one cloud, placed by their nodes.

    Raises:
        FormatError: not GLB, no splats in it, accessors outside of the file, a node that shears.
        InputError: a rotation of length zero, too many Gaussians.
    """
    document = open_gltf(read_all(stream, MAX_FILE_BYTES), companions={})
    primitives = [
        (instance.transform, primitive)
        for instance in mesh_instances(document)
        for primitive in object_list(instance.mesh, "primitives")
        if EXTENSION in object_field(primitive, "extensions")
    ]
    if any(integer_field(primitive, "mode", high=6, default=4) != _POINTS for _, primitive in primitives):
        raise FormatError(f"a primitive with {EXTENSION} is not of points (mode 0); the extension allows no other")
    if not primitives:
        raise FormatError(f"the GLB file has no primitive with {EXTENSION} in its scene; it is no Gaussian splat")
    check_count(sum(_count(document, primitive) for _, primitive in primitives))
    stored = [_read_primitive(document, primitive) for _, primitive in primitives]
    if min(cloud.scales.min() for cloud in stored) < 0:  # negative scales are logarithms, as in an early draft
        stored = [replace(cloud, scales=scales_from_log(cloud.scales)) for cloud in stored]
    return join_clouds([_placed(cloud, transform) for cloud, (transform, _) in zip(stored, primitives, strict=True)])


def write_gltf_gaussian(cloud: GaussianCloud, stream: ByteWriter) -> None:
    """Write one primitive of 32-bit floats, in the source's units and +Y up, as glTF requires."""
    source = to_source_axes(cloud, UP_AXIS)
    attributes = {
        "POSITION": source.means,
        f"{EXTENSION}:ROTATION": source.quaternions[:, [1, 2, 3, 0]],
        f"{EXTENSION}:SCALE": source.scales,
        f"{EXTENSION}:OPACITY": source.opacity[:, None],
    } | {_harmonic_name(h): source.sh[:, h] for h in range(source.sh.shape[1])}
    extension = {
        "kernel": "ellipse",
        "colorSpace": "srgb_rec709_display",
        "projection": "perspective",
        "sortingMethod": "cameraDistance",
    }
    writer = GlbWriter(root={"extensionsUsed": [EXTENSION]})
    primitive = {
        "attributes": {name: writer.add_accessor(v, bounds=name == "POSITION") for name, v in attributes.items()},
        "mode": _POINTS,
        "extensions": {EXTENSION: extension},
    }
    writer.append("meshes", {"primitives": [primitive]})
    writer.append("nodes", {"mesh": 0})
    writer.finish(stream)


def _count(document: GltfDocument, primitive: JsonObject) -> int:
    return _rows(document, object_field(primitive, "attributes"), "POSITION")[1]


def _rows(document: GltfDocument, attributes: JsonObject, name: str) -> tuple[int, int, int]:
    """Return the accessor of an attribute, its count and its width, from the JSON alone."""
    accessor = index_field(attributes, name, document.accessors, "accessors")
    if accessor is None:
        raise FormatError(f"a splat of the GLB file has no attribute {name}; found are {', '.join(sorted(attributes))}")
    count, _, width = accessor_layout(document.accessors[accessor], f"accessors[{accessor}]")
    return accessor, count, width


def _read_primitive(document: GltfDocument, primitive: JsonObject) -> GaussianCloud:
    attributes = object_field(primitive, "attributes")
    count = _count(document, primitive)

    def column(name: str, width: int) -> Float32[np.ndarray, "G width"]:
        accessor, *shape = _rows(document, attributes, name)
        if shape != [count, width]:
            raise FormatError(f"attribute {name} of the GLB file is {tuple(shape)}; {(count, width)} is needed")
        return document.accessor(accessor).astype(np.float32)

    num_harmonics = sum(1 for name in attributes if name.startswith(f"{EXTENSION}:SH_DEGREE_"))
    if num_harmonics not in SH_DEGREES:
        raise FormatError(f"a splat of the GLB file has {num_harmonics} harmonics; 1, 4, 9 or 16 are allowed")
    sh = np.stack([column(_harmonic_name(h), 3) for h in range(num_harmonics)], axis=1)
    extension = object_field(object_field(primitive, "extensions"), EXTENSION)
    if extension.get("colorSpace") == "lin_rec709_display":
        linear = np.clip(sh[:, 0] * SH_0 + 0.5, 0, 1).astype(np.float64)
        mean = (linear_to_srgb(linear) - 0.5) / SH_0  # exact; the view-dependent part is of first order
        sh = np.concatenate([mean[:, None], sh[:, 1:] * srgb_slope(linear)[:, None]], axis=1).astype(np.float32)
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


def _placed(cloud: GaussianCloud, transform: Float64[np.ndarray, "4 4"]) -> GaussianCloud:
    max_shear = 1e-3  # share of a node's scale; a Gaussian keeps its shape only under rotation and uniform scale
    linear = transform[:3, :3]
    scale = float(np.cbrt(np.linalg.det(linear)))
    rotation, _ = scipy.linalg.polar(linear)
    if not scale > 0 or np.abs(linear - scale * rotation).max() > max_shear * scale:
        raise FormatError(
            "a node of the GLB file mirrors, shears or stretches its splat; bake the transform into the splat"
        )
    turned = transform_cloud(cloud, rotation, scale)
    return replace(turned, means=(turned.means + transform[:3, 3]).astype(np.float32))
