"""Render meshes on the CPU with a rasteriser in numba, without OpenGL or a GPU."""

from dynamictree.render.camera import Camera, cameras_of
from dynamictree.render.contact_sheet import amplitude_colors, draw_contact_sheet, sway_amplitude
from dynamictree.render.ground import Backdrop
from dynamictree.render.picture import Buffers, Renderer, RenderSettings, write_png
from dynamictree.render.video import stored_frames, write_mp4, write_webp

__all__ = [
    "Backdrop",
    "Buffers",
    "Camera",
    "RenderSettings",
    "Renderer",
    "amplitude_colors",
    "cameras_of",
    "draw_contact_sheet",
    "stored_frames",
    "sway_amplitude",
    "write_mp4",
    "write_png",
    "write_webp",
]
