"""Contact sheets for manual review: the rest pose and a strip of the motion. Paper appendix A, step 3."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import UInt8
from PIL import Image, ImageDraw, ImageFont

from dynamictree.render import Camera, Renderer, RenderSettings, amplitude_colors, sway_amplitude
from dynamictree.spectrum import iter_motion
from lab.dataset.sample import Sample

CELL_PX = 150
STRIP = 6  # number of frames of the loop
TITLE_PX = 18
PAPER, INK = (250, 249, 247), (60, 60, 64)


def draw_sheet(samples: Sequence[Sample]) -> UInt8[np.ndarray, "H W 3"]:
    """Draw one row per tree at one scale: rest pose, sway as colours (blue: none, yellow: most), frames of the loop."""
    width, row = CELL_PX * (STRIP + 2), CELL_PX + TITLE_PX
    sheet = Image.new("RGB", (width, row * len(samples)), PAPER)
    pen, font = ImageDraw.Draw(sheet), ImageFont.load_default(12)
    for index, sample in enumerate(samples):
        wind = sample.wind
        title = (
            f"{sample.seed}  {sample.species}  {sample.mesh.height_m:.1f} m  {sample.mesh.num_vertices:,} vertices  "
            f"wind {wind.speed_m_s:.1f} m/s to {wind.direction_deg:.0f}°, gust {wind.gust:.2f}"
        )
        pen.text((4, index * row + 2), title, fill=INK, font=font)
        sheet.paste(Image.fromarray(motion_strip(sample)), (0, index * row + TITLE_PX))
    return np.asarray(sheet)


def motion_strip(sample: Sample) -> UInt8[np.ndarray, "H W 3"]:
    """Draw one tree's pictures side by side."""
    look = RenderSettings(width=CELL_PX, height=CELL_PX)
    renderer = Renderer(sample.mesh, look)
    camera = Camera.orbit(sample.mesh.vertices, aspect=1.0)
    frames = iter_motion(sample.coefficients, np.arange(STRIP) / STRIP)
    moving = [renderer.picture(frame, camera=camera) for frame in frames]
    return np.concatenate([renderer.picture(camera=camera), _sway_picture(sample, camera), *moving], axis=1)


def _sway_picture(sample: Sample, camera: Camera) -> UInt8[np.ndarray, "H W 3"]:
    from dataclasses import replace

    colors = amplitude_colors(sway_amplitude(sample.coefficients))
    plain = replace(sample.mesh, look=replace(sample.mesh.look, vertex_colors=colors, face_material=None, materials=()))
    return Renderer(plain, RenderSettings(width=CELL_PX, height=CELL_PX, shadows=False)).picture(camera=camera)
