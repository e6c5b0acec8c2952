"""The products: what a motion can be written as. A new format is added here, and to `requests.Format`."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import PurePosixPath
from typing import BinaryIO, Literal

from dynamictree.export.mesh_files import (
    write_displacements,
    write_glb,
    write_ply_sequence,
    write_reduced_glb,
    write_skinned_glb,
    write_usdz,
    write_vertex_texture,
)
from dynamictree.export.moving_tree import Facts, MovingTree, Report
from dynamictree.export.pictures import Film, write_film_sheet, write_mesh_sheet, write_mp4, write_webp
from dynamictree.export.splat_files import write_compact_splat, write_splat_sequence
from dynamictree.requests import Format

MEDIA_TYPES = {
    ".zip": "application/zip",
    ".glb": "model/gltf-binary",
    ".usdz": "model/vnd.usdz+zip",
    ".png": "image/png",
    ".webp": "image/webp",
    ".mp4": "video/mp4",
}
SPEED = frozenset({"speed"})
FRAMES = SPEED | {"wind_mode", "num_frames", "fps", "loop", "first_frame"}
DETAIL = frozenset({"share", "sh_degree"})
SHOT = frozenset({"shot"})
NORMALS = frozenset({"normals"})


@dataclass(frozen=True, kw_only=True)
class Product:
    """One format: its file, what it shows, the fields of `ExportParams` that it depends on, and its writer.

    A product with `write_film` is made of pictures that are drawn once for all of them; one with both writers is made
    of pictures where a splat was captured.
    """

    title: str
    file_name: str
    shows: Literal["mesh", "splat", "pictures"]
    options: frozenset[str]
    write: Callable[[MovingTree, BinaryIO, Report], Facts | None] | None = None
    write_film: Callable[[Film, BinaryIO, float], None] | None = None

    @property
    def media_type(self) -> str:
        """Media type of the file."""
        return media_type(self.file_name)


def media_type(file_name: str) -> str:
    """Media type of a file, by the end of its name."""
    return MEDIA_TYPES.get(PurePosixPath(file_name).suffix, "application/octet-stream")


PRODUCTS: dict[Format, Product] = {
    "ply": Product(
        title="PLY sequence",
        file_name="motion.ply.zip",
        shows="mesh",
        options=FRAMES,
        write=write_ply_sequence,
    ),
    "glb": Product(
        title="Animated GLB",
        file_name="tree.glb",
        shows="mesh",
        options=SPEED | NORMALS,
        write=write_glb,
    ),
    "glb-reduced": Product(
        title="Animated GLB, 8 targets",
        file_name="tree-8-targets.glb",
        shows="mesh",
        options=SPEED | NORMALS,
        write=write_reduced_glb,
    ),
    "glb-skinned": Product(
        title="Skinned GLB",
        file_name="tree-skinned.glb",
        shows="mesh",
        options=SPEED,
        write=write_skinned_glb,
    ),
    "usd": Product(
        title="USD",
        file_name="tree.usdz",
        shows="mesh",
        options=FRAMES,
        write=write_usdz,
    ),
    "vat": Product(
        title="Vertex animation texture",
        file_name="tree.vat.zip",
        shows="mesh",
        options=FRAMES | NORMALS,
        write=write_vertex_texture,
    ),
    "motion": Product(
        title="Motion, every frame",
        file_name="motion.safetensors",
        shows="mesh",
        options=FRAMES,
        write=write_displacements,
    ),
    "splat-ply": Product(
        title="Splat sequence",
        file_name="splat.ply.zip",
        shows="splat",
        options=FRAMES | DETAIL,
        write=write_splat_sequence,
    ),
    "splat": Product(
        title="Animated splat",
        file_name="tree.animated-splat.safetensors",
        shows="splat",
        options=SPEED | DETAIL,
        write=write_compact_splat,
    ),
    "png": Product(
        title="Preview picture",
        file_name="preview.png",
        shows="pictures",
        options=FRAMES | DETAIL | SHOT,
        write=write_mesh_sheet,
        write_film=write_film_sheet,
    ),
    "webp": Product(
        title="Preview, animated",
        file_name="preview.webp",
        shows="pictures",
        options=FRAMES | DETAIL | SHOT,
        write_film=write_webp,
    ),
    "mp4": Product(
        title="Preview, video",
        file_name="preview.mp4",
        shows="pictures",
        options=FRAMES | DETAIL | SHOT,
        write_film=write_mp4,
    ),
}
