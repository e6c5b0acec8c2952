"""Pictures of meshes on the CPU: a rasteriser in numba, no GL and no GPU."""

from dynamictree.render.camera import Camera
from dynamictree.render.ground import Backdrop
from dynamictree.render.picture import Buffers, Look, Renderer, render_mesh, write_png
from dynamictree.render.sheet import amplitude_colors, preview_sheet, sway_amplitude
from dynamictree.render.shot import cameras_of
from dynamictree.render.video import VIDEO_FORMATS, VideoFormat, spooled, write_animation

__all__ = [
    "VIDEO_FORMATS",
    "Backdrop",
    "Buffers",
    "Camera",
    "Look",
    "Renderer",
    "VideoFormat",
    "amplitude_colors",
    "cameras_of",
    "preview_sheet",
    "render_mesh",
    "spooled",
    "sway_amplitude",
    "write_animation",
    "write_png",
]
