"""A motion as a vertex animation texture: what engines play in the vertex shader, instance by instance.

A ZIP of `tree.glb` (at rest; its last texture coordinates say where in the texture a vertex is), `displacement.exr`
(half floats), `vat.json` and, where asked for, `normal.exr` in the same layout. A frame takes `rows_per_frame` rows of
texels, frame 0 on top.

A mesh that was read from glTF stays in its document. A texel is added to the position of a vertex before its skin and
nodes place it, as a morph target is: it is in the primitive's own axes and units.
"""

import io
import json
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float16, Float32

from dynamictree.errors import InputError
from dynamictree.formats.gltf.template import MorphSlot, Template, open_template
from dynamictree.formats.motion.exr import write_exr
from dynamictree.formats.stored_zip import iter_stored_zip
from dynamictree.mesh import TriangleMesh

VERSION = 2
_SMALLEST_UNIT, _LARGEST_UNIT = 2e-5, 1e3
"""Of a primitive, as shares of the mesh's height: beyond these a half overflows at 65,504, or its steps are coarse."""
MAX_SIDE = 8192  # texels; what Unreal takes without further settings, and every desktop GPU


@dataclass(frozen=True, kw_only=True)
class TextureLayout:
    """Where a vertex and a frame are: texel (n % width, frame · rows_per_frame + n // width)."""

    width: int
    rows_per_frame: int
    num_frames: int

    @property
    def height(self) -> int:
        """Rows of the texture."""
        return self.rows_per_frame * self.num_frames


def texture_layout(num_vertices: int, num_frames: int) -> TextureLayout:
    """The narrowest texture, its width a power of two, that is no higher than `MAX_SIDE`, and rather square.

    Raises:
        InputError: there is none.
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


def iter_vertex_texture_zip(
    mesh: TriangleMesh,
    frames: Iterable[Float32[np.ndarray, "N 3"]],
    *,
    num_frames: int,
    fps: float,
    loop: bool,
    normals: Iterable[Float32[np.ndarray, "N 3"]] | None = None,
) -> Iterator[bytes]:
    """Chunks of the archive; `frames` are displacements [m], `normals` the unit normals at each frame.

    Raises:
        InputError: the mesh and its frames do not fit into one texture.
    """
    layout = texture_layout(mesh.num_vertices, num_frames)
    template = _template(mesh)
    moved = _Texels(layout, template.slots, MorphSlot.local)
    texels = moved.of(frames)
    facts = {
        "format": "vertex-animation-texture",
        "version": VERSION,
        "mesh": "tree.glb",
        "texture": "displacement.exr",
        "num_vertices": mesh.num_vertices,
        "width": layout.width,
        "height": layout.height,
        "rows_per_frame": layout.rows_per_frame,
        "num_frames": num_frames,
        "fps": fps,
        "duration_s": num_frames / fps,
        "loop": loop,
        "lookup_attribute": (attribute := template.attach_texture_coordinates(_lookup(layout, mesh.num_vertices))),
        "lookup": f"{attribute} is a vertex' texel in frame 0; add frame * rows_per_frame / height to v",
        "space": "each primitive's own axes and units, before its skin and nodes, as a morph target",
        "primitives": [slot.described() for slot in template.slots],
        "max_displacement_m": moved.largest_m,
        "half_float_error_m": moved.error_m,
    }
    directions = []
    if normals is not None:
        facts["normal_texture"] = "normal.exr"
        turned = _Texels(layout, template.slots, MorphSlot.local_normals).of(normals)
        directions = [("normal.exr", [_picture(turned)])]
    rest = io.BytesIO()
    template.writer.finish(rest)
    yield from iter_stored_zip(
        [
            ("vat.json", [json.dumps(facts, indent=1).encode()]),
            ("tree.glb", [rest.getvalue()]),
            ("displacement.exr", [_picture(texels)]),
            *directions,
        ]
    )


def _template(mesh: TriangleMesh) -> Template:
    """The mesh's document; a new one where the source's units are so small or large that halves do not hold them."""
    template = open_template(mesh)
    units_m = [slot.metres_per_unit for slot in template.slots]
    if _SMALLEST_UNIT * mesh.height_m < min(units_m) and max(units_m) < _LARGEST_UNIT * mesh.height_m:
        return template
    return open_template(replace(mesh, gltf=None))


@dataclass
class _Texels:
    """Vectors of the mesh as the primitives have them, in the texture's layout."""

    layout: TextureLayout
    slots: Sequence[MorphSlot]
    local: Callable[[MorphSlot, Float32[np.ndarray, "N 3"]], Float32[np.ndarray, "n 3"]]
    largest_m: float = 0.0  # in any direction
    error_m: float = 0.0  # of rounding to halves, in any direction

    def of(self, frames: Iterable[Float32[np.ndarray, "N 3"]]) -> Float16[np.ndarray, "H W 3"]:
        """The picture of all frames; what no primitive shows stays 0."""
        layout = self.layout
        texels = np.zeros((layout.num_frames, layout.rows_per_frame * layout.width, 3), np.float16)
        most = np.zeros(len(self.slots))
        for number, vectors in enumerate(frames):
            for index, slot in enumerate(self.slots):
                own = self.local(slot, vectors)
                texels[number, slot.rows] = own.astype(np.float16)
                most[index] = max(most[index], float(np.abs(own).max(initial=0)))
            self.largest_m = max(self.largest_m, float(np.abs(vectors).max(initial=0)))
        halves = np.spacing(most.astype(np.float16)).astype(np.float64) / 2
        self.error_m = max((s.metres_per_unit * e for s, e in zip(self.slots, halves, strict=True)), default=0.0)
        return texels.reshape(layout.height, layout.width, 3)


def _lookup(layout: TextureLayout, num_vertices: int) -> Float32[np.ndarray, "N 2"]:
    """Middle of the texel of each vertex in frame 0."""
    number = np.arange(num_vertices)
    column, row = number % layout.width, number // layout.width
    return np.stack([(column + 0.5) / layout.width, (row + 0.5) / layout.height], axis=1).astype(np.float32)


def _picture(texels: Float16[np.ndarray, "H W 3"]) -> bytes:
    stream = io.BytesIO()
    write_exr(texels, stream)
    return stream.getvalue()
