"""Readers of splats and scans, chosen by file type."""

from collections.abc import Callable
from typing import Literal, get_args

from dynamictree.errors import FormatError
from dynamictree.formats.gltf import gaussian as gltf_gaussian
from dynamictree.formats.gltf.document import glb_json
from dynamictree.formats.json_fields import object_field, object_list
from dynamictree.formats.ply_table import PlyHeader, read_header
from dynamictree.formats.scan import las, pcd, points, text
from dynamictree.formats.seekable import SeekableReader
from dynamictree.formats.splat import compressed_ply, ksplat, sog, splat, spz
from dynamictree.formats.splat import ply as gaussian_ply
from dynamictree.gaussian.axes import to_z_up
from dynamictree.gaussian.cloud import GaussianCloud, validate_cloud
from dynamictree.plant.find import CloudFacts

CloudKind = Literal["gaussians", "compressed-gaussians", "points", "mesh"]
CloudType = Literal[
    "ply", "splat", "spz", "sog", "ksplat", "glb", "xyz", "txt", "csv", "asc", "pts", "pcd", "las", "laz"
]
CLOUD_TYPES: tuple[CloudType, ...] = get_args(CloudType)
SPLAT_TYPES: tuple[CloudType, ...] = ("splat", "spz", "sog", "ksplat")
"""Types that the file name's ending identifies; they contain only Gaussians."""


_SPLATS: dict[str, tuple[Callable[[SeekableReader], GaussianCloud], str]] = {
    "gaussians": (gaussian_ply.read_gaussian_ply, gaussian_ply.UP_AXIS),
    "compressed-gaussians": (compressed_ply.read_compressed_ply, gaussian_ply.UP_AXIS),
    "splat": (splat.read_splat, splat.UP_AXIS),
    "spz": (spz.read_spz, spz.UP_AXIS),
    "sog": (sog.read_sog, sog.UP_AXIS),
    "ksplat": (ksplat.read_ksplat, ksplat.UP_AXIS),
    "glb": (gltf_gaussian.read_gltf_gaussian, gltf_gaussian.UP_AXIS),
}
"""Reader and usual up axis by file type, or by the kind of a PLY."""
_SCANS: dict[str, Callable[[SeekableReader], points.Scan]] = {
    "points": points.read_points_ply,
    **dict.fromkeys(("xyz", "txt", "csv", "asc", "pts"), text.read_points_text),
    "pcd": pcd.read_pcd,
    **dict.fromkeys(("las", "laz"), las.read_las),
}


def read_cloud(
    stream: SeekableReader, *, file_type: str, up_axis: str | None = None, unit_m: float | None = None
) -> GaussianCloud:
    """Read a splat or a scan, in metres and +Z up.

    Args:
        stream: the file, at its start.
        file_type: the file name's ending, without a dot and in lower case.
        up_axis: the file's; by default from a PLY comment, else its format's convention:
            −Y for splats, +Y for SPZ and GLB, +Z for scans.
        unit_m: metres per unit of the file; by default from a PLY comment or a LAS file's coordinate system, else 1.

    Raises:
        FormatError: an unknown type, or a file that is not of its type.
        InputError: the content cannot be used: values that are not finite, nothing visible, too many Gaussians.
    """
    if file_type not in CLOUD_TYPES:
        raise FormatError(f"no cloud is read from .{file_type[:20]} files; choose from {', '.join(CLOUD_TYPES)}")
    kind, stated_m = str(file_type), unit_m
    if file_type == "ply":
        start = stream.tell()
        header = read_header(stream)
        stream.seek(start)
        kind, up_axis = _ply_kind(header), up_axis or header.up_axis
        stated_m = header.unit_m if unit_m is None else unit_m
        if kind == "mesh":
            raise FormatError("the PLY file has faces; it is a mesh, not a cloud; send it as a mesh")
    if kind in _SPLATS:
        read, usual_up = _SPLATS[kind]
        cloud, unit_of_file = read(stream), 1.0
        up_axis = up_axis or usual_up
    else:
        up_axis = up_axis or points.UP_AXIS
        scan = las.read_las(stream, unit_m=unit_m) if kind in ("las", "laz") else _SCANS[kind](stream)
        cloud, unit_of_file = points.cloud_of_points(scan, up_axis=up_axis), scan.unit_m
    return to_z_up(validate_cloud(cloud), up_axis=up_axis, unit_m=unit_of_file if stated_m is None else stated_m)


_OF_PHOTOS = frozenset(("x", "y", "z", "nx", "ny", "nz", "red", "green", "blue", "alpha"))


def cloud_kind(stream: SeekableReader, *, file_type: str) -> CloudKind:
    """Return the kind of a file from its header; the stream is left at its start.

    PLY and GLB may hold a mesh or a cloud: a PLY with faces, and a GLB without splats, are meshes.

    Raises:
        FormatError: the header breaks its format's rules.
    """
    stream.seek(0)
    if file_type == "ply":
        kind = _ply_kind(read_header(stream))
    elif file_type == "glb":
        primitives = [p for mesh in object_list(glb_json(stream), "meshes") for p in object_list(mesh, "primitives")]
        splats = any(gltf_gaussian.EXTENSION in object_field(primitive, "extensions") for primitive in primitives)
        kind = "gaussians" if splats else "mesh"
    elif file_type in CLOUD_TYPES:
        kind = "gaussians" if file_type in SPLAT_TYPES else "points"
    else:
        kind = "mesh"
    stream.seek(0)
    return kind


def cloud_facts(stream: SeekableReader, *, file_type: str) -> CloudFacts:
    """Return what a file states about its origin, axis and unit; the stream is left at its start.

    PLY points with only normals and colours count as made from photos, as COLMAP and Open3D write them: scanners write
    intensities, and other formats of scans have a unit.
    """
    if file_type in (*SPLAT_TYPES, "glb"):
        return CloudFacts(origin="splat")
    if file_type != "ply":
        return CloudFacts(origin="scan", says_axis=True, says_unit=True)
    stream.seek(0)
    header = read_header(stream)
    stream.seek(0)
    vertex = header.element("vertex")
    names = frozenset[str]() if vertex is None else vertex.names
    says_axis, says_unit = header.up_axis is not None, header.unit_m is not None
    if _ply_kind(header) != "points":
        return CloudFacts(origin="splat", says_axis=says_axis, says_unit=says_unit)
    if names >= {"nx", "ny", "nz", "red", "green", "blue"} and names <= _OF_PHOTOS:
        return CloudFacts(origin="photos", says_axis=says_axis, says_unit=says_unit)
    return CloudFacts(origin="scan", says_axis=says_axis, says_unit=True)


def _ply_kind(header: PlyHeader) -> CloudKind:
    vertex, face = header.element("vertex"), header.element("face")
    if compressed_ply.is_compressed(header):
        return "compressed-gaussians"
    if vertex and (vertex.names & {"f_dc_0", "scale_0", "rot_0"}):
        return "gaussians"
    return "mesh" if face and face.count > 0 else "points"
