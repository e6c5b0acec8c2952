"""Readers of splats and scans, chosen by file type."""

from typing import Literal, Protocol, get_args

from dynamictree.errors import FormatError
from dynamictree.formats.gltf import gaussian as gltf_gaussian
from dynamictree.formats.gltf.document import glb_json
from dynamictree.formats.json_fields import object_field, object_list
from dynamictree.formats.ply_table import PlyHeader, read_header
from dynamictree.formats.scan import las, pcd, points, text
from dynamictree.formats.seekable import SeekableReader
from dynamictree.formats.splat import compressed_ply, ksplat, sog, splat, spz
from dynamictree.formats.splat import ply as gaussian_ply
from dynamictree.gaussian.cloud import GaussianCloud
from dynamictree.plant.find import CloudFacts

CloudKind = Literal["gaussians", "compressed-gaussians", "points", "mesh"]
CloudType = Literal[
    "ply", "splat", "spz", "sog", "ksplat", "glb", "xyz", "txt", "csv", "asc", "pts", "pcd", "las", "laz"
]
CLOUD_TYPES: tuple[CloudType, ...] = get_args(CloudType)
SPLAT_TYPES: tuple[CloudType, ...] = ("splat", "spz", "sog", "ksplat")
"""Those whose ending decides: all that is in them are Gaussians."""


class _Reader(Protocol):
    def __call__(self, stream: SeekableReader, *, up_axis: str, unit_m: float) -> GaussianCloud: ...


_READERS: dict[str, tuple[_Reader, str]] = {
    "splat": (splat.read_splat, splat.UP_AXIS),
    "spz": (spz.read_spz, spz.UP_AXIS),
    "sog": (sog.read_sog, sog.UP_AXIS),
    "ksplat": (ksplat.read_ksplat, ksplat.UP_AXIS),
    "glb": (gltf_gaussian.read_gltf_gaussian, gltf_gaussian.UP_AXIS),
    **dict.fromkeys(("xyz", "txt", "csv", "asc", "pts"), (text.read_points_text, points.UP_AXIS)),
    "pcd": (pcd.read_pcd, pcd.UP_AXIS),
    **dict.fromkeys(("las", "laz"), (las.read_las, points.UP_AXIS)),
}


def read_cloud(
    stream: SeekableReader, *, file_type: str, up_axis: str | None = None, unit_m: float | None = None
) -> GaussianCloud:
    """Read a splat or a scan, in metres and +Z up.

    Args:
        stream: stands at the file's start.
        file_type: the file name's ending, without a dot and in lower case.
        up_axis: the file's; by default what a PLY comment says, else its format's habit:
            −Y for splats, +Y for SPZ and GLB, +Z for scans.
        unit_m: metres per unit of the file, by default 1, or what a LAS file's coordinate system says.

    Raises:
        FormatError: a type that is not understood, or a file that is not of its type.
        InputError: what the file holds cannot be used.
    """
    if file_type == "ply":
        return _read_ply(stream, up_axis, unit_m)
    if unit_m is None and file_type in ("las", "laz"):
        return las.read_las(stream, up_axis=up_axis or points.UP_AXIS)
    if file_type not in _READERS:
        raise FormatError(f"no cloud is read from .{file_type[:20]} files; choose from {', '.join(CLOUD_TYPES)}")
    read, usual_up = _READERS[file_type]
    return read(stream, up_axis=up_axis or usual_up, unit_m=1.0 if unit_m is None else unit_m)


_OF_PHOTOS = frozenset(("x", "y", "z", "nx", "ny", "nz", "red", "green", "blue", "alpha"))


def cloud_kind(stream: SeekableReader, *, file_type: str) -> CloudKind:
    """Describe a file by its header alone; the stream is left at its start.

    PLY and GLB may hold a mesh or a cloud: a PLY with faces, and a GLB without splats, are meshes.

    Raises:
        FormatError: a type that is not understood, or a header that breaks its format's rules.
    """
    stream.seek(0)
    if file_type == "ply":
        kind = _ply_kind(read_header(stream))
    elif file_type == "glb":
        primitives = [p for mesh in object_list(glb_json(stream), "meshes") for p in object_list(mesh, "primitives")]
        splats = any(gltf_gaussian.EXTENSION in object_field(primitive, "extensions") for primitive in primitives)
        kind = "gaussians" if splats else "mesh"
    elif file_type in _READERS:
        kind = "gaussians" if file_type in SPLAT_TYPES else "points"
    else:
        kind = "mesh"
    stream.seek(0)
    return kind


def cloud_facts(stream: SeekableReader, *, file_type: str) -> CloudFacts:
    """What a file says of its origin, axis and unit; the stream is left at its start.

    Points of a PLY with normals and colours and nothing else were made from photos, as COLMAP and Open3D write them:
    scanners write intensities, and other formats of scans have a unit.
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


def _read_ply(stream: SeekableReader, up_axis: str | None, unit_m: float | None) -> GaussianCloud:
    start = stream.tell()
    header = read_header(stream)
    kind = _ply_kind(header)
    stream.seek(start)
    up_axis = up_axis or header.up_axis
    if unit_m is None:
        unit_m = header.unit_m or 1.0
    if kind == "mesh":
        raise FormatError("the PLY file has faces; it is a mesh, not a cloud; send it as a mesh")
    if kind == "points":
        return points.read_points_ply(stream, up_axis=up_axis or points.UP_AXIS, unit_m=unit_m)
    if kind == "compressed-gaussians":
        return compressed_ply.read_compressed_ply(stream, up_axis=up_axis or gaussian_ply.UP_AXIS, unit_m=unit_m)
    return gaussian_ply.read_gaussian_ply(stream, up_axis=up_axis or gaussian_ply.UP_AXIS, unit_m=unit_m)
