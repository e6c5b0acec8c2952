"""Render a mesh from a camera to a picture."""

from copy import copy
from dataclasses import dataclass, replace
from io import BytesIO
from typing import NamedTuple

import numpy as np
from jaxtyping import Float32, Float64, Int32, UInt8
from PIL import Image

from dynamictree.byte_stream import ByteWriter
from dynamictree.errors import InputError
from dynamictree.mesh import TriangleMesh, validate_mesh, vertex_normals
from dynamictree.parallel import in_bands
from dynamictree.render.appearance import Appearance, appearance_of
from dynamictree.render.camera import Camera
from dynamictree.render.light import BARE_SUN, OPEN_SKY, SkyVolume, SunMap, sky_volume, sun_map
from dynamictree.render.raster import ScreenTriangles, Visible, rasterise, screen_triangles
from dynamictree.render.shade import Scene, View, shade_rows

MAX_SIDE_PX = 4096
"""Of a picture: 4096² with 2×2 samples is half a gigabyte of z-buffer."""


@dataclass(frozen=True, kw_only=True)
class Look:
    """Settings of the renderer."""

    width: int = 512
    height: int = 512
    supersampling: int = 2  # samples a pixel along each axis
    ground: bool = True  # a level floor below the lowest vertex
    grey_still: bool = False  # what stands still because it is no plant without its colours
    shadows: bool = True  # of the sun, and the sky dimmed by what is around
    sun_direction: tuple[float, float, float] = (-0.40, -0.45, 0.95)  # towards it

    def __post_init__(self) -> None:
        if not (1 <= self.width <= MAX_SIDE_PX and 1 <= self.height <= MAX_SIDE_PX and 1 <= self.supersampling <= 4):
            size = f"{self.width} x {self.height} pixels with {self.supersampling}² samples"
            raise InputError(f"a picture of {size}; 1 to {MAX_SIDE_PX} pixels a side and 1 to 4 are allowed")


class Buffers(NamedTuple):
    """What a camera sees at the centre of each pixel, without colour."""

    depth_m: Float32[np.ndarray, "H W"]  # along the camera's axis; infinite where nothing is
    normals: Float32[np.ndarray, "H W 3"]  # of the face, in the world, towards the camera; 0 where nothing is
    face: Int32[np.ndarray, "H W"]  # -1 where nothing is


class _Surface(NamedTuple):
    """Faces that are drawn, all of a mesh or some."""

    faces: Int32[np.ndarray, "F 3"]
    appearance: Appearance


class Renderer:
    """Pictures of one mesh in many poses: its colours and the light in its crown are prepared once."""

    def __init__(self, mesh: TriangleMesh, look: Look | None = None) -> None:
        """Prepare a mesh; its rest pose dims the sky, and sets ground and camera.

        Raises:
            MeshError: the mesh cannot be drawn.
            FormatError: a texture is no picture.
        """
        self.mesh = validate_mesh(mesh)
        self.look = look or Look()
        visible = mesh.vertices[~mesh.still_vertices]  # the plant, not the plane that it stands on
        self.camera = Camera.orbit(visible, aspect=self.look.width / self.look.height)
        self._appearance = appearance_of(mesh, grey_still=self.look.grey_still)
        low, high = mesh.vertices.min(axis=0).astype(np.float64), mesh.vertices.max(axis=0).astype(np.float64)
        self._centre = np.array([(low[0] + high[0]) / 2, (low[1] + high[1]) / 2, low[2]])
        self._radius_m = float(np.linalg.norm(high - low)) / 2
        sun = np.array(self.look.sun_direction, np.float64)
        self._sun_direction = sun / np.linalg.norm(sun)
        self._sky: SkyVolume = sky_volume(mesh.vertices, mesh.faces) if self.look.shadows else OPEN_SKY
        self._sun: SunMap = self._shadow_of(mesh.vertices)

    def with_size(self, *, width: int, height: int) -> "Renderer":
        """Draw the same mesh in the same light in another size of picture."""
        other = copy(self)
        other.look = replace(self.look, width=width, height=height)
        other.camera = Camera.orbit(self.mesh.vertices[~self.mesh.still_vertices], aspect=width / height)
        return other

    def picture(
        self,
        displacement: Float32[np.ndarray, "N 3"] | None = None,
        *,
        camera: Camera | None = None,
        rows: range | None = None,
    ) -> UInt8[np.ndarray, "H W 3"]:
        """Draw the mesh, its vertices displaced [m]; only some rows of the picture if asked.

        Rows alone keep the shadows of the rest pose: a slice of a motion costs a fraction of its pictures.
        """
        look, camera = self.look, camera or self.camera
        rows = rows or range(look.height)
        vertices = self.mesh.vertices if displacement is None else self.mesh.vertices + displacement
        whole = len(rows) == look.height
        surface = _Surface(self.mesh.faces, self._appearance)
        if not whole:
            surface = self._near_rows(surface, vertices, camera, rows)
        triangles, visible = self._see(surface, vertices, camera, rows, look.supersampling)
        moved = displacement is not None and whole
        positions = vertices.astype(np.float64)
        scene = Scene(
            vertices=positions,
            normals=vertex_normals(positions, surface.faces),
            faces=surface.faces,
            appearance=surface.appearance,
            sun_direction=self._sun_direction,
            sun=self._shadow_of(vertices) if moved else self._sun,
            sky=self._sky,
            shadows=look.shadows,
            ground=look.ground,
            centre=self._centre,
            radius_m=self._radius_m,
        )
        to_sample = _samples(camera, look, rows, look.supersampling)
        ray = camera.world_to_camera.T @ np.linalg.inv(to_sample)
        view = View(position=camera.position_m, ray=np.ascontiguousarray(ray), supersampling=look.supersampling)
        picture = np.empty((len(rows), look.width, 3), np.uint8)
        in_bands(shade_rows, len(rows), picture, visible.face, triangles, scene, view)
        return picture

    def buffers(self, camera: Camera | None = None) -> Buffers:
        """Depth, normals and faces of the rest pose, one sample a pixel."""
        camera = camera or self.camera
        surface = _Surface(self.mesh.faces, self._appearance)
        _, visible = self._see(surface, self.mesh.vertices, camera, range(self.look.height), 1)
        seen = visible.face >= 0
        depth = np.where(seen, 1 / np.where(seen, visible.nearness, 1), np.inf).astype(np.float32)
        a, b, c = (self.mesh.vertices[self.mesh.faces[:, corner]].astype(np.float64) for corner in range(3))
        normals = np.cross(b - a, c - a)
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
        away = np.einsum("fc,fc->f", normals, a - camera.position_m) > 0
        normals[away] *= -1
        picture = np.where(seen[..., None], normals[visible.face], 0).astype(np.float32)
        return Buffers(depth_m=depth, normals=picture, face=visible.face)

    def _shadow_of(self, vertices: Float32[np.ndarray, "N 3"]) -> SunMap:
        if not self.look.shadows:
            return BARE_SUN
        return sun_map(vertices, self.mesh.faces, self._appearance, self._sun_direction)

    def _near_rows(
        self, surface: "_Surface", vertices: Float32[np.ndarray, "N 3"], camera: Camera, rows: range
    ) -> "_Surface":
        """The faces that may be seen in some rows, and those around their vertices, which bend their normals."""
        _, y, depth = self._homogeneous(vertices, camera, rows, 1).T
        row = y / np.where(depth > 0, depth, 1)
        above, below, behind = row < 0, row > len(rows), depth <= 0
        corners = surface.faces
        outside = above[corners].all(axis=1) | below[corners].all(axis=1)
        seen = ~outside | behind[corners].any(axis=1)
        used = np.zeros(len(vertices), np.bool_)
        used[corners[seen]] = True
        near = used[corners].any(axis=1)
        material = surface.appearance.face_material[near]
        return _Surface(corners[near], surface.appearance._replace(face_material=material))

    def _homogeneous(
        self, vertices: Float32[np.ndarray, "N 3"], camera: Camera, rows: range, supersampling: int
    ) -> Float64[np.ndarray, "N 3"]:
        to_sample = _samples(camera, self.look, rows, supersampling)
        to_rows: Float64[np.ndarray, "3 3"] = to_sample @ camera.world_to_camera
        homogeneous: Float64[np.ndarray, "N 3"] = (vertices - camera.position_m) @ to_rows.T
        return homogeneous

    def _see(
        self,
        surface: "_Surface",
        vertices: Float32[np.ndarray, "N 3"],
        camera: Camera,
        rows: range,
        supersampling: int,
    ) -> tuple[ScreenTriangles, Visible]:
        size = {"width": self.look.width * supersampling, "height": len(rows) * supersampling}
        homogeneous = np.ascontiguousarray(self._homogeneous(vertices, camera, rows, supersampling))
        ones = np.ones(len(vertices), np.float32)
        triangles = screen_triangles(homogeneous, surface.faces, surface.appearance, **size)
        return triangles, rasterise(triangles, surface.faces, ones, surface.appearance, **size)


def render_mesh(
    mesh: TriangleMesh, camera: Camera | None = None, *, look: Look | None = None
) -> UInt8[np.ndarray, "H W 3"]:
    """One picture of a mesh; from the front, a little from above, if no camera is given.

    Raises:
        MeshError: the mesh cannot be drawn.
        FormatError: a texture is no picture.
    """
    return Renderer(mesh, look).picture(camera=camera)


def write_png(image: UInt8[np.ndarray, "H W 3"], stream: ByteWriter) -> None:
    """Write a picture as PNG."""
    content = BytesIO()
    Image.fromarray(image).save(content, format="PNG", compress_level=6)
    stream.write(content.getvalue())


def _samples(camera: Camera, look: Look, rows: range, supersampling: int) -> Float64[np.ndarray, "3 3"]:
    """Camera axes to samples of the rows, sample centres at half-integers."""
    matrix = camera.intrinsics_px(look.width, look.height)
    matrix[1, 2] -= rows.start
    matrix[:2] *= supersampling
    return matrix
