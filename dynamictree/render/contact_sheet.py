"""Contact sheet: preview of a motion in one picture."""

from dataclasses import dataclass, replace
from io import BytesIO

import numpy as np
from jaxtyping import Bool, Complex64, Float32, UInt8
from PIL import Image, ImageDraw, ImageFont

from dynamictree.mesh import Material, TriangleMesh
from dynamictree.parallel import on_cores
from dynamictree.render.picture import Renderer, RenderSettings
from dynamictree.spectrum import NUM_FRAMES, bin_weights, iter_motion

STILL_PX, SWAY_PX = (800, 800), (480, 800)
"""Width and height of the large picture, and of the sway picture beside it."""
STRIP_PX, NUM_STRIP = (160, 232), 8
"""Width and height of the pictures in the row, and their number."""
_TITLE_PX = 26  # height of the title above each part
_STILLNESS_TO_SWAY = np.array([[52, 58, 94], [46, 110, 142], [64, 168, 130], [176, 206, 78], [253, 231, 37]])


def sway_amplitude(
    coefficients: Complex64[np.ndarray, "N K 3"], num_frames: int = NUM_FRAMES
) -> Float32[np.ndarray, " N"]:
    """Compute each vertex's root mean square distance from its mean position over a loop [m], by Parseval's theorem."""
    weights = bin_weights(coefficients.shape[1], num_frames)
    power = (np.abs(coefficients) ** 2).sum(axis=2)  # [N, K]
    amplitude: Float32[np.ndarray, " N"] = np.sqrt(power[:, 1:] @ weights[1:])
    return amplitude


def amplitude_colors(
    amplitude: Float32[np.ndarray, " N"], still: Bool[np.ndarray, " N"] | None = None
) -> UInt8[np.ndarray, "N 4"]:
    """Map amplitudes to colours from blue (rest) to yellow (largest); `still` vertices (no plant) are grey."""
    stands = (150, 150, 147)  # colour of still parts
    top = float(amplitude.max())
    place = amplitude / top * (len(_STILLNESS_TO_SWAY) - 1) if top > 0 else np.zeros_like(amplitude)
    anchors = np.arange(len(_STILLNESS_TO_SWAY))
    rgb = np.stack([np.interp(place, anchors, channel) for channel in _STILLNESS_TO_SWAY.T], axis=1)
    if still is not None:
        rgb[still] = stands
    return np.concatenate([rgb.round(), np.full((len(rgb), 1), 255)], axis=1).astype(np.uint8)


def draw_contact_sheet(
    mesh: TriangleMesh, coefficients: Complex64[np.ndarray, "N K 3"], *, num_frames: int = NUM_FRAMES
) -> UInt8[np.ndarray, "H W 3"]:
    """Draw a contact sheet: one still, the sway in colours, frames in a row.

    The coefficients are those of the vertices [m]; a loop has `num_frames` frames.
    """
    still_renderer = Renderer(mesh, RenderSettings(width=STILL_PX[0], height=STILL_PX[1]))
    amplitude = sway_amplitude(coefficients, num_frames)
    stands = mesh.still_vertices
    sheet = ContactSheet(
        still=still_renderer.picture(next(iter_motion(coefficients, np.zeros(1), num_frames))),
        sway=_sway_picture(mesh, amplitude),
        strip=_frames_in_a_row(still_renderer, coefficients, num_frames),
        title=f"{mesh.num_vertices:,} vertices, {mesh.num_faces:,} faces, {mesh.height_text} high",
        most_m=float(amplitude.max()),
        some_stand=bool(stands.any()),
        num_frames=num_frames,
    )
    return sheet.picture()


@dataclass(frozen=True, kw_only=True)
class ContactSheet:
    """Parts of a contact sheet, and values for their titles."""

    still: UInt8[np.ndarray, "S S 3"]
    sway: UInt8[np.ndarray, "H W 3"]  # amplitude in colours
    strip: UInt8[np.ndarray, "h w 3"]  # `NUM_STRIP` frames side by side
    title: str  # title of the still
    most_m: float  # the largest amplitude [m]
    some_stand: bool  # whether still parts are grey
    num_frames: int  # number of frames in the loop

    def picture(self) -> UInt8[np.ndarray, "A B 3"]:
        """Draw all parts as one picture."""
        paper, ink = (250, 249, 247), (70, 70, 74)
        width, height = STILL_PX
        sheet = Image.new("RGB", (width + SWAY_PX[0], 2 * _TITLE_PX + height + STRIP_PX[1]), paper)
        pen, font = ImageDraw.Draw(sheet), ImageFont.load_default(15)
        sheet.paste(Image.fromarray(self.still), (0, _TITLE_PX))
        sheet.paste(Image.fromarray(self.sway), (width, _TITLE_PX))
        sheet.paste(Image.fromarray(self.strip), (0, 2 * _TITLE_PX + height))
        scale = f"0 (blue) to {_length(self.most_m)} (yellow)" + (", grey: stands still" if self.some_stand else "")
        titles = (
            ((8, 4), self.title),
            ((width + 8, 4), f"sway, root mean square: {scale}"),
            ((8, 4 + _TITLE_PX + height), f"one loop of {self.num_frames} frames"),
        )
        for place, words in titles:
            pen.text(place, words, fill=ink, font=font)
        return np.asarray(sheet)


def _length(length_m: float) -> str:
    return f"{length_m:.2g} m" if length_m >= 1 else f"{100 * length_m:.2g} cm"


def _sway_picture(mesh: TriangleMesh, amplitude: Float32[np.ndarray, " N"]) -> UInt8[np.ndarray, "H W 3"]:
    colored = replace(
        mesh,
        look=replace(
            mesh.look,
            vertex_colors=amplitude_colors(amplitude, mesh.still_vertices),
            materials=tuple(_whitened(material) for material in mesh.look.materials) or (_whitened(Material()),),
        ),
    )
    return Renderer(colored, RenderSettings(width=SWAY_PX[0], height=SWAY_PX[1], shadows=False)).picture()


def _whitened(material: Material) -> Material:
    """Return the material in white; only the alpha of a cut-out texture is retained."""
    shape = None if material.alpha_cutoff is None else material.texture_png
    texture = None if shape is None else _white_texture(shape)
    return replace(material, base_color=(1.0, 1.0, 1.0, material.base_color[3]), texture_png=texture)


def _white_texture(texture: bytes) -> bytes:
    """Return a white texture with the alpha of the given one."""
    with Image.open(BytesIO(texture)) as picture:
        alpha = picture.convert("RGBA").getchannel("A")
    white = Image.merge("LA", (Image.new("L", alpha.size, 255), alpha))
    content = BytesIO()
    white.save(content, "png", compress_level=1)
    return content.getvalue()


def _frames_in_a_row(
    renderer: Renderer, coefficients: Complex64[np.ndarray, "N K 3"], num_frames: int
) -> UInt8[np.ndarray, "H W 3"]:
    renderer = renderer.with_size(width=STRIP_PX[0], height=STRIP_PX[1])
    phases = np.arange(NUM_STRIP) / NUM_STRIP
    frames = iter_motion(coefficients, phases, num_frames)
    return np.concatenate(on_cores(renderer.picture, frames), axis=1)
