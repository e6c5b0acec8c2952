"""Render a mesh from a camera to a picture."""

from copy import copy
from dataclasses import dataclass, replace
from io import BytesIO
from typing import NamedTuple

import numpy as np
from jaxtyping import Float32, Float64, Int32, UInt8
from PIL import Image

from dynamictree.byte_stream import ByteWriter
from dynamictree.color import linear_to_srgb
from dynamictree.errors import InputError
from dynamictree.mesh import TriangleMesh, validate_mesh, vertex_normals
from dynamictree.parallel import in_bands
from dynamictree.render.appearance import Appearance, appearance_of
from dynamictree.render.camera import Camera, points_in_view
from dynamictree.render.light import BARE_SUN, OPEN_SKY, SkyVolume, SunMap, sky_volume, sun_map
from dynamictree.render.raster import ScreenTriangles, Visible, rasterise, screen_triangles
from dynamictree.render.shade import Scene, View, shade_rows


@dataclass(frozen=True, kw_only=True)
class RenderSettings:
    """Settings of the renderer."""

    width: int = 512
    height: int = 512
    supersampling: int = 2  # samples per pixel along each axis
    ground: bool = True  # draw a level floor below the lowest vertex
    grey_still: bool = False  # draw still parts, which are no plant, in grey
    shadows: bool = True  # shadows of the sun, and ambient occlusion of the sky
    sun_direction: tuple[float, float, float] = (-0.40, -0.45, 0.95)  # direction towards the sun

    def __post_init__(self) -> None:
        max_side_px = 4096  # side of a picture; 4096² with 2×2 samples take half a gigabyte of z-buffer
        if not (1 <= self.width <= max_side_px and 1 <= self.height <= max_side_px and 1 <= self.supersampling <= 4):
            size = f"{self.width} x {self.height} pixels with {self.supersampling}² samples"
            raise InputError(f"a picture of {size}; 1 to {max_side_px} pixels a side and 1 to 4 are allowed")


class Buffers(NamedTuple):
    """Depth and face at the centre of each pixel."""

    depth_m: Float32[np.ndarray, "H W"]  # depth along the camera's axis; infinite without a face
    face: Int32[np.ndarray, "H W"]  # -1 without a face


class _Surface(NamedTuple):
    """Vertices, faces and appearance of the drawn mesh."""

    vertices: Float32[np.ndarray, "N 3"]  # [m]
    faces: Int32[np.ndarray, "F 3"]
    appearance: Appearance


class Renderer:
    """Renderer of one mesh in many poses; colours and the light in the crown are prepared once."""

    def __init__(self, mesh: TriangleMesh, look: RenderSettings | None = None) -> None:
        """Prepare a mesh; its rest pose determines the sky's occlusion, the ground and the camera.

        Raises:
            MeshError: the mesh cannot be drawn.
            FormatError: a texture is not a picture.
        """
        self.mesh = validate_mesh(mesh)
        self.look = look or RenderSettings()
        self._in_view = mesh.vertices[points_in_view(mesh.vertices, ~mesh.still_vertices)]
        self.camera = Camera.orbit(self._in_view, aspect=self.look.width / self.look.height)
        appearance = appearance_of(mesh, grey_still=self.look.grey_still)
        self._surface = _Surface(mesh.vertices, mesh.faces, appearance)
        low, high = mesh.vertices.min(axis=0).astype(np.float64), mesh.vertices.max(axis=0).astype(np.float64)
        self._centre = np.array([(low[0] + high[0]) / 2, (low[1] + high[1]) / 2, low[2]])
        self._radius_m = float(np.linalg.norm(high - low)) / 2
        sun = np.array(self.look.sun_direction, np.float64)
        self._sun_direction = sun / np.linalg.norm(sun)
        self._sky: SkyVolume = sky_volume(mesh.vertices, mesh.faces) if self.look.shadows else OPEN_SKY
        self._sun: SunMap = self._shadow_of(mesh.vertices)

    def with_size(self, *, width: int, height: int) -> "Renderer":
        """Return a renderer of the same mesh and light with another picture size."""
        other = copy(self)
        other.look = replace(self.look, width=width, height=height)
        other.camera = Camera.orbit(self._in_view, aspect=width / height)
        return other

    def picture(
        self, displacement: Float32[np.ndarray, "N 3"] | None = None, *, camera: Camera | None = None
    ) -> UInt8[np.ndarray, "H W 3"]:
        """Render the mesh with displaced vertices [m]."""
        if displacement is None:
            surface, sun = self._surface, self._sun
        else:
            surface = self._surface._replace(vertices=self.mesh.vertices + displacement)
            sun = self._shadow_of(surface.vertices)
        return self._drawn(surface, sun, camera or self.camera)

    def _drawn(self, surface: "_Surface", sun: SunMap, camera: Camera) -> UInt8[np.ndarray, "H W 3"]:
        look = self.look
        triangles, visible = self._see(surface, camera, look.supersampling)
        positions = surface.vertices.astype(np.float64)
        scene = Scene(
            vertices=positions,
            normals=vertex_normals(positions, surface.faces),
            faces=surface.faces,
            appearance=surface.appearance,
            sun_direction=self._sun_direction,
            sun=sun,
            sky=self._sky,
            shadows=look.shadows,
            ground=look.ground,
            centre=self._centre,
            radius_m=self._radius_m,
        )
        ray = camera.world_to_camera.T @ np.linalg.inv(_samples(camera, look, look.supersampling))
        view = View(position=camera.position_m, ray=np.ascontiguousarray(ray), supersampling=look.supersampling)
        light = np.empty((look.height, look.width, 3), np.float32)
        in_bands(shade_rows, look.height, light, visible.face, triangles, scene, view)
        return np.asarray(np.rint(255 * linear_to_srgb(light)), np.uint8)

    def buffers(self, camera: Camera | None = None) -> Buffers:
        """Render depth and faces of the rest pose, with one sample per pixel."""
        camera = camera or self.camera
        _, visible = self._see(self._surface, camera, 1)
        seen = visible.face >= 0
        depth = np.where(seen, 1 / np.where(seen, visible.nearness, 1), np.inf).astype(np.float32)
        return Buffers(depth_m=depth, face=visible.face)

    def _shadow_of(self, vertices: Float32[np.ndarray, "N 3"]) -> SunMap:
        if not self.look.shadows:
            return BARE_SUN
        return sun_map(vertices, self.mesh.faces, self._surface.appearance, self._sun_direction)

    def _see(self, surface: "_Surface", camera: Camera, supersampling: int) -> tuple[ScreenTriangles, Visible]:
        size = {"width": self.look.width * supersampling, "height": self.look.height * supersampling}
        to_sample = _samples(camera, self.look, supersampling) @ camera.world_to_camera
        homogeneous = np.ascontiguousarray((surface.vertices - camera.position_m) @ to_sample.T)
        ones = np.ones(len(surface.vertices), np.float32)
        triangles = screen_triangles(homogeneous, surface.faces, surface.appearance, **size)
        return triangles, rasterise(triangles, surface.faces, ones, surface.appearance, **size)


def write_png(image: UInt8[np.ndarray, "H W 3"], stream: ByteWriter) -> None:
    """Write a picture as PNG."""
    content = BytesIO()
    Image.fromarray(image).save(content, format="PNG", compress_level=6)
    stream.write(content.getvalue())


def _samples(camera: Camera, look: RenderSettings, supersampling: int) -> Float64[np.ndarray, "3 3"]:
    """Return the matrix from camera axes to samples, with sample centres at half-integers."""
    matrix = camera.intrinsics_px(look.width, look.height)
    matrix[:2] *= supersampling
    return matrix
