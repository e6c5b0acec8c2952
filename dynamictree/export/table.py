"""The table of export products. A new format is added here and to `requests.Format`."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import PurePosixPath
from typing import BinaryIO, Literal

from dynamictree.errors import InputError
from dynamictree.export.engine_files import write_engine_wind, write_levels, write_rig
from dynamictree.export.mesh_files import (
    write_alembic,
    write_displacements,
    write_glb,
    write_morph_glb,
    write_page,
    write_ply_sequence,
    write_skinned_usdz,
    write_usdz,
    write_vertex_texture,
)
from dynamictree.export.moving_tree import Facts, MovingTree, Report
from dynamictree.export.pictures import write_sheet
from dynamictree.export.splat_files import write_compact_splat, write_splat_page, write_splat_sequence, write_usd_splat
from dynamictree.render.video import Picture, write_mp4, write_webp
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
FLUTTER = frozenset({"flutter"})
FRAMES = SPEED | FLUTTER | {"wind_mode", "num_frames", "fps", "loop", "first_frame"}
DETAIL = frozenset({"share", "sh_degree"})
PLAYED = SPEED | FLUTTER | DETAIL
SHOT = frozenset({"shot"})
NORMALS = frozenset({"normals"})
SKIN = SPEED | FLUTTER | {"joints"}
PACKING = frozenset({"glb_compression", "glb_textures"})
MORPHS = SPEED | FLUTTER  # morph targets lack flutter, and their error reports it


@dataclass(frozen=True)
class Product:
    """One format: its file, what it shows, the fields of `ExportParams` that it depends on, and its writer.

    Products with `write_film` are made of pictures, which are drawn once for all of them. A product with `module` and
    `extra` needs a library that only this extra of the package installs.
    """

    title: str
    file_name: str
    shows: Literal["mesh", "splat", "pictures"]
    options: frozenset[str]
    module: str = ""
    extra: str = ""
    write: Callable[[MovingTree, BinaryIO, Report], Facts | None] | None = None
    write_film: Callable[[Iterable[Picture], BinaryIO, float], None] | None = None

    @property
    def media_type(self) -> str:
        """Media type of the file."""
        return media_type(self.file_name)

    @property
    def available(self) -> bool:
        """Whether the library that it needs is installed."""
        return not self.module or find_spec(self.module) is not None


def media_type(file_name: str) -> str:
    """Return the media type of a file name. A page is a download, as it must not run in the service's origin."""
    return MEDIA_TYPES.get(PurePosixPath(file_name).suffix, "application/octet-stream")


PRODUCTS: dict[Format, Product] = {
    "ply": Product("PLY sequence", "motion.ply.zip", "mesh", FRAMES, write=write_ply_sequence),
    "glb": Product("Animated GLB", "tree.glb", "mesh", SKIN | PACKING, write=write_glb),
    "glb-morph": Product("GLB with morph targets", "tree-morph.glb", "mesh", MORPHS, write=write_morph_glb),
    "lod": Product("Levels of detail", "tree.lod.zip", "mesh", SPEED, write=write_levels),
    "rig": Product("Rig, collision, wind groups", "tree.rig.zip", "mesh", SPEED, write=write_rig),
    "wind": Product("Wind for engines", "tree.wind.zip", "mesh", FLUTTER, write=write_engine_wind),
    "html": Product("Web page that plays from disk", "tree.html", "mesh", SPEED | FLUTTER, write=write_page),
    "usd": Product("USD", "tree.usdz", "mesh", FRAMES, "pxr", "usd", write=write_usdz),
    "usd-skinned": Product(
        "USD with joints", "tree-skinned.usdz", "mesh", SKIN, "pxr", "usd", write=write_skinned_usdz
    ),
    "alembic": Product("Alembic", "tree.abc", "mesh", FRAMES, "alembic3d", "alembic", write=write_alembic),
    "vat": Product("Vertex animation texture", "tree.vat.zip", "mesh", FRAMES | NORMALS, write=write_vertex_texture),
    "motion": Product("Motion, every frame", "motion.safetensors", "mesh", FRAMES, write=write_displacements),
    "splat-ply": Product("Splat sequence", "splat.ply.zip", "splat", FRAMES | DETAIL, write=write_splat_sequence),
    "splat": Product("Animated splat", "tree.animated-splat.safetensors", "splat", PLAYED, write=write_compact_splat),
    "html-splat": Product("Web page of a splat", "tree-splat.html", "splat", PLAYED, write=write_splat_page),
    "usd-splat": Product("USD splat", "tree-splat.usdz", "splat", FRAMES | DETAIL, "pxr", "usd", write=write_usd_splat),
    "png": Product("Preview picture", "preview.png", "pictures", DETAIL | SHOT, write=write_sheet),
    "webp": Product("Preview, animated", "preview.webp", "pictures", FRAMES | DETAIL | SHOT, write_film=write_webp),
    "mp4": Product(
        "Preview, video",
        "preview.mp4",
        "pictures",
        FRAMES | DETAIL | SHOT,
        "imageio_ffmpeg",
        "video",
        write_film=write_mp4,
    ),
}


def available_products() -> dict[Format, Product]:
    """Return the products that this installation can write."""
    return {name: product for name, product in PRODUCTS.items() if product.available}


def require_available(formats: Iterable[Format]) -> None:
    """Refuse formats whose library is not installed.

    Raises:
        InputError: a library is not installed; the message says how to install it.
    """
    for name in formats:
        product = PRODUCTS[name]
        if not product.available:
            raise InputError(
                f"format {name} needs the Python module {product.module}, which is not installed: "
                f"pip install 'dynamictree[{product.extra}]'"
            )
