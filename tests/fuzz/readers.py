"""What is done to a file of each format: as the parser's child does to an upload, and a worker to a product."""

import io
import tempfile
from collections.abc import Callable
from pathlib import Path

from dynamictree.errors import InputError
from dynamictree.formats.cloud_file import cloud_kind, read_cloud
from dynamictree.formats.mesh_file import read_mesh, sniff_file_type
from dynamictree.formats.tensors.bundle import read_mesh_bundle
from dynamictree.formats.tensors.spectrum import read_spectrum
from dynamictree.formats.tensors.voxels import read_voxels
from jobs.storage.parser_process import ParseRequest
from service.http.multipart import ReceivedFile
from service.uploads.archives import is_zip, unpack
from worker import parse

MESHES = (".obj", ".ply", ".glb", ".gltf", ".stl")


def mesh(ending: str) -> Callable[[bytes], object]:
    """As an upload of this name: its bytes decide its type."""

    def read(content: bytes) -> object:
        file_type = sniff_file_type(content[: 64 * 1024], f"tree.{ending}")
        return read_mesh(io.BytesIO(content), file_type=file_type)

    return read


def cloud(ending: str) -> Callable[[bytes], object]:
    def read(content: bytes) -> object:
        stream = io.BytesIO(content)
        cloud_kind(stream, file_type=ending)
        return read_cloud(stream, file_type=ending)

    return read


def photo(content: bytes) -> object:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "photo")
        path.write_bytes(content)
        return photos([path])


def photos(paths: list[Path]) -> object:
    request = ParseRequest(
        kind="photos",
        names=tuple(path.name for path in paths),
        paths=tuple(paths),
        prepared=Path("unused"),
        memory_bytes=1 << 30,
        cpu_s=10,
    )
    answer = parse._photos(request)
    if answer.summary is None:
        raise InputError(f"{answer.code}: {answer.message}")
    return answer


def archive(content: bytes) -> object:
    """Unpacked as an upload is; what comes out is read as the upload would be."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "upload.zip")
        path.write_bytes(content)
        if not is_zip(path):
            return sniff_file_type(content[: 64 * 1024], "upload.zip")
        sent = ReceivedFile(name="upload.zip", path=path, sha256="", bytes=len(content))
        files = unpack(sent, Path(folder))
        meshes = [file for file in files if file.name.lower().endswith(MESHES)]
        if not meshes:
            return photos([file.path for file in files])
        main = meshes[0]
        beside = {file.name: file.path.read_bytes() for file in files if file is not main}
        with main.path.open("rb") as stream:
            file_type = sniff_file_type(stream.read(64 * 1024), main.name)
            stream.seek(0)
            return read_mesh(stream, file_type=file_type, companions=beside)


def tensors(read: Callable[[io.BytesIO], object]) -> Callable[[bytes], object]:
    return lambda content: read(io.BytesIO(content))


READERS: dict[str, Callable[[bytes], object]] = {
    "obj": mesh("obj"),
    "ply-mesh": mesh("ply"),
    "ply-splat": cloud("ply"),
    "stl": mesh("stl"),
    "glb": mesh("glb"),
    "dae": mesh("dae"),
    "gltf-zip": archive,
    "obj-zip": archive,
    "splat": cloud("splat"),
    "spz": cloud("spz"),
    "sog": cloud("sog"),
    "ksplat": cloud("ksplat"),
    "las": cloud("las"),
    "pcd": cloud("pcd"),
    "xyz": cloud("xyz"),
    "khr-glb": cloud("glb"),
    "spectrum": tensors(read_spectrum),
    "voxels": tensors(read_voxels),
    "mesh-bundle": tensors(read_mesh_bundle),
    "jpeg": photo,
    "png": photo,
    "webp-tiff": photo,
    "zip": archive,
}
