"""Preview of a motion as one still picture."""

from dataclasses import replace

import numpy as np
from jaxtyping import Complex64, Float32, UInt8
from PIL import Image, ImageDraw, ImageFont

from dynamictree.mesh import Material, TriangleMesh
from dynamictree.render.camera import Camera
from dynamictree.render.picture import Look, Renderer
from dynamictree.spectrum import NUM_FRAMES, bin_weights, displacement_at, iter_motion

_STILL_PX, _SIDE_PX = 800, 480  # the large picture, the width of the two beside it
_STRIP_PX = (160, 232)  # width and height of those in the row
_TITLE_PX = 26  # above each part
_NUM_STRIP = 8
_SLICE_SWAY_PX = 14  # the slice is enlarged until the swaying part moves about so far
_MAX_ZOOM = 8.0
_LINE_REACH_PX = 6  # vertices so near above and below count for the line
_PAPER, _INK = (250, 249, 247), (70, 70, 74)
_STILLNESS_TO_SWAY = np.array([[52, 58, 94], [46, 110, 142], [64, 168, 130], [176, 206, 78], [253, 231, 37]])


def sway_amplitude(
    coefficients: Complex64[np.ndarray, "N K 3"], num_frames: int = NUM_FRAMES
) -> Float32[np.ndarray, " N"]:
    """Root mean square distance of each vertex from its mean place over one loop [m]; Parseval's theorem."""
    weights = bin_weights(coefficients.shape[1], num_frames)
    power = (np.abs(coefficients) ** 2).sum(axis=2)  # [N, K]
    amplitude: Float32[np.ndarray, " N"] = np.sqrt(power[:, 1:] @ weights[1:])
    return amplitude


def amplitude_colors(amplitude: Float32[np.ndarray, " N"]) -> UInt8[np.ndarray, "N 4"]:
    """From blue, at rest, to yellow, where it sways most."""
    top = float(amplitude.max())
    place = amplitude / top * (len(_STILLNESS_TO_SWAY) - 1) if top > 0 else np.zeros_like(amplitude)
    anchors = np.arange(len(_STILLNESS_TO_SWAY))
    rgb = np.stack([np.interp(place, anchors, channel) for channel in _STILLNESS_TO_SWAY.T], axis=1)
    return np.concatenate([rgb.round(), np.full((len(rgb), 1), 255)], axis=1).astype(np.uint8)


def preview_sheet(
    mesh: TriangleMesh, coefficients: Complex64[np.ndarray, "N K 3"], *, num_frames: int = NUM_FRAMES
) -> UInt8[np.ndarray, "H W 3"]:
    """One still, the sway in colours, a line of pixels stacked over time (as the paper's figures do), frames in a row.

    The coefficients are the vertices' own [m]; one loop has `num_frames`.
    """
    still_renderer = Renderer(mesh, Look(width=_STILL_PX, height=_STILL_PX))
    camera = still_renderer.camera
    amplitude = sway_amplitude(coefficients, num_frames)
    still = still_renderer.picture(displacement_at(coefficients, 0.0, num_frames))
    line, window = _slice_window(mesh, amplitude, camera)
    time_slice = _space_time_slice(still_renderer, coefficients, num_frames, window)
    strip = _frames_in_a_row(still_renderer, coefficients, num_frames)

    half = (_STILL_PX - _TITLE_PX) // 2
    sheet = Image.new("RGB", (_STILL_PX + _SIDE_PX, 2 * _TITLE_PX + _STILL_PX + _STRIP_PX[1]), _PAPER)
    pen, font = ImageDraw.Draw(sheet), ImageFont.load_default(15)
    sheet.paste(Image.fromarray(still), (0, _TITLE_PX))
    pen.line([(line[0], line[2] + _TITLE_PX), (line[1], line[2] + _TITLE_PX)], fill=(220, 60, 40), width=2)
    sheet.paste(Image.fromarray(_sway_picture(mesh, amplitude, camera, half)), (_STILL_PX, _TITLE_PX))
    enlarged = Image.fromarray(time_slice).resize((_SIDE_PX, half), Image.Resampling.BICUBIC)
    sheet.paste(enlarged, (_STILL_PX, 2 * _TITLE_PX + half))
    sheet.paste(Image.fromarray(strip), (0, 2 * _TITLE_PX + _STILL_PX))
    titles = (
        ((8, 4), f"{mesh.num_vertices:,} vertices, {mesh.num_faces:,} faces, {mesh.height_m:.2f} m high"),
        ((_STILL_PX + 8, 4), f"sway, root mean square: 0 (blue) to {100 * amplitude.max():.2g} cm (yellow)"),
        ((_STILL_PX + 8, 4 + _TITLE_PX + half), "the red line over one loop, time runs down"),
        ((8, 4 + _TITLE_PX + _STILL_PX), f"one loop of {num_frames} frames"),
    )
    for place, title in titles:
        pen.text(place, title, fill=_INK, font=font)
    return np.asarray(sheet)


def _sway_picture(
    mesh: TriangleMesh, amplitude: Float32[np.ndarray, " N"], camera: Camera, height: int
) -> UInt8[np.ndarray, "H W 3"]:
    colored = replace(
        mesh,
        vertex_colors=amplitude_colors(amplitude),
        materials=tuple(_bare(material) for material in mesh.materials) or (_bare(Material()),),
    )
    return Renderer(colored, Look(width=_SIDE_PX, height=height, shadows=False)).picture(camera=camera)


def _bare(material: Material) -> Material:
    """White; a texture stays only where it cuts the face out."""
    texture = None if material.alpha_cutoff is None else material.texture_png
    return replace(material, base_color=(1.0, 1.0, 1.0, material.base_color[3]), texture_png=texture)


def _slice_window(
    mesh: TriangleMesh, amplitude: Float32[np.ndarray, " N"], camera: Camera
) -> tuple[tuple[int, int, int], Camera]:
    """The line through the most swaying place: its first and last column and row in the still; a camera for it."""
    x, y, depth = camera.project(mesh.vertices.astype(np.float64), _STILL_PX, _STILL_PX).T
    rows = np.clip(y, 0, _STILL_PX - 1).astype(int)
    power = amplitude**2 + 1e-12
    crowded = np.convolve(np.bincount(rows, power, minlength=_STILL_PX), np.ones(2 * _LINE_REACH_PX + 1), mode="same")
    row = int(crowded.argmax())
    on_row = np.abs(rows - row) <= _LINE_REACH_PX
    column = float(np.average(x[on_row], weights=power[on_row]))
    sway_px = float(np.mean(2 * amplitude[on_row] * camera.focal * _STILL_PX / depth[on_row]))
    spread_px = 1.5 * float(np.abs(x[on_row] - column).max()) + 1
    zoom = max(_SLICE_SWAY_PX / max(sway_px, 1e-9), 0.5 * _STILL_PX / spread_px)
    half = 0.5 * _STILL_PX / float(np.clip(zoom, 1.0, _MAX_ZOOM))
    zoom = 0.5 * _STILL_PX / half
    column = float(np.clip(column, half, _STILL_PX - half))
    centre = ((camera.centre[0] - column / _STILL_PX) * zoom + 0.5, (camera.centre[1] - row / _STILL_PX) * zoom + 0.5)
    zoomed = replace(camera, focal=camera.focal * zoom, centre=centre)
    return (int(column - half), int(column + half), row), zoomed


def _space_time_slice(
    renderer: Renderer, coefficients: Complex64[np.ndarray, "N K 3"], num_frames: int, window: Camera
) -> UInt8[np.ndarray, "T W 3"]:
    renderer = renderer.with_size(width=_SIDE_PX, height=_SIDE_PX)
    middle = range(_SIDE_PX // 2, _SIDE_PX // 2 + 1)
    phases = np.arange(num_frames) / num_frames
    frames = iter_motion(coefficients, phases, num_frames)
    return np.concatenate([renderer.picture(frame, camera=window, rows=middle) for frame in frames])


def _frames_in_a_row(
    renderer: Renderer, coefficients: Complex64[np.ndarray, "N K 3"], num_frames: int
) -> UInt8[np.ndarray, "H W 3"]:
    renderer = renderer.with_size(width=_STRIP_PX[0], height=_STRIP_PX[1])
    phases = np.arange(_NUM_STRIP) / _NUM_STRIP
    frames = iter_motion(coefficients, phases, num_frames)
    return np.concatenate([renderer.picture(frame) for frame in frames], axis=1)
