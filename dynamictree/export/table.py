"""The table of export products. A new format is added here and to `requests.Format`."""

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


@dataclass(frozen=True)
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
    "ply": Product("PLY sequence", "motion.ply.zip", "mesh", FRAMES, write=write_ply_sequence),
    "glb": Product("Animated GLB", "tree.glb", "mesh", SPEED | NORMALS, write=write_glb),
    "glb-reduced": Product(
        "Animated GLB, 8 targets", "tree-8-targets.glb", "mesh", SPEED | NORMALS, write=write_reduced_glb
    ),
    "glb-skinned": Product("Skinned GLB", "tree-skinned.glb", "mesh", SPEED, write=write_skinned_glb),
    "usd": Product("USD", "tree.usdz", "mesh", FRAMES, write=write_usdz),
    "vat": Product("Vertex animation texture", "tree.vat.zip", "mesh", FRAMES | NORMALS, write=write_vertex_texture),
    "motion": Product("Motion, every frame", "motion.safetensors", "mesh", FRAMES, write=write_displacements),
    "splat-ply": Product("Splat sequence", "splat.ply.zip", "splat", FRAMES | DETAIL, write=write_splat_sequence),
    "splat": Product(
        "Animated splat", "tree.animated-splat.safetensors", "splat", SPEED | DETAIL, write=write_compact_splat
    ),
    "png": Product(
        "Preview picture",
        "preview.png",
        "pictures",
        FRAMES | DETAIL | SHOT,
        write=write_mesh_sheet,
        write_film=write_film_sheet,
    ),
    "webp": Product("Preview, animated", "preview.webp", "pictures", FRAMES | DETAIL | SHOT, write_film=write_webp),
    "mp4": Product("Preview, video", "preview.mp4", "pictures", FRAMES | DETAIL | SHOT, write_film=write_mp4),
}
