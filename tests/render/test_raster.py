"""The z-buffer against a slow loop that casts a ray through every pixel (Möller and Trumbore)."""

import numpy as np

from benchmarks._gaussian_scene import wavy_sheet
from dynamictree.mesh import TriangleMesh
from dynamictree.render import Camera, Renderer, RenderSettings

SIZE = 96


def cast_rays(mesh: TriangleMesh, camera: Camera, size: int) -> tuple[np.ndarray, np.ndarray]:
    """Nearest face and depth along the camera's axis through each pixel's centre, in float64."""
    column, row = np.meshgrid(np.arange(size) + 0.5, np.arange(size) + 0.5)
    pixels = np.stack([column, row, np.ones_like(row)], axis=2).reshape(-1, 3)
    rays = pixels @ np.linalg.inv(camera.intrinsics_px(size, size)).T @ camera.world_to_camera  # depth 1 along the axis
    nearest, face_at = np.full(len(rays), np.inf), np.full(len(rays), -1)
    for number, corners in enumerate(mesh.vertices[mesh.faces].astype(np.float64)):
        a, u, v = corners[0], corners[1] - corners[0], corners[2] - corners[0]
        p = np.cross(rays, v)
        determinant = p @ u
        with np.errstate(divide="ignore", invalid="ignore"):
            s = p @ (camera.position_m - a) / determinant
            q = np.cross(camera.position_m - a, u)
            t, depth = rays @ q / determinant, v @ q / determinant
        hit = (s >= 0) & (t >= 0) & (s + t <= 1) & (depth > 0) & (depth < nearest)
        nearest[hit], face_at[hit] = depth[hit], number
    return nearest.reshape(size, size), face_at.reshape(size, size)


def test_sees_what_a_ray_through_every_pixel_hits(two_balls):
    camera = Camera.orbit(two_balls.vertices, azimuth_deg=0.0)
    buffers = Renderer(two_balls, RenderSettings(width=SIZE, height=SIZE)).buffers(camera)
    depth, face = cast_rays(two_balls, camera, SIZE)
    seen = np.isfinite(depth)
    assert seen.mean() > 0.2
    assert (np.isfinite(buffers.depth_m) == seen).mean() > 0.9995
    both = seen & np.isfinite(buffers.depth_m)
    assert np.allclose(buffers.depth_m[both], depth[both], rtol=1e-5)
    assert (buffers.face[both] == face[both]).mean() > 0.999  # two faces share the samples on their edge


def test_a_triangle_that_reaches_behind_the_camera_is_drawn_where_it_is_seen():
    floor = TriangleMesh(
        vertices=np.array([[-9, -9, 0], [9, -9, 0], [0, 30, 0]], np.float32), faces=np.array([[0, 1, 2]], np.int32)
    )
    camera = Camera.look_at(np.array([0.0, 0, 1.5]), np.array([0.0, 5, 0.5]), vertical_fov_deg=60.0)
    renderer = Renderer(floor, RenderSettings(width=SIZE, height=SIZE))
    beyond = Camera.look_at(np.array([0.0, 40, 1.5]), np.array([0.0, 50, 1.0]))
    assert (renderer.buffers(beyond).face == -1).all(), "all of it is behind the camera"
    buffers = renderer.buffers(camera)
    depth, _ = cast_rays(floor, camera, SIZE)
    assert 0.4 < np.isfinite(depth).mean() < 0.95
    assert (np.isfinite(buffers.depth_m) == np.isfinite(depth)).all()
    assert np.allclose(buffers.depth_m[np.isfinite(depth)], depth[np.isfinite(depth)], rtol=1e-5)


def test_faces_that_share_an_edge_leave_no_gap(rng):
    """A wavy sheet that covers the whole picture: not one pixel shows through."""
    number = 60
    x, z = np.meshgrid(np.linspace(-3, 3, number), np.linspace(-3, 3, number), indexing="ij")
    inner = np.zeros_like(x)
    inner[1:-1, 1:-1] = 1
    jitter = rng.uniform(-0.03, 0.03, (2, number, number)) * inner
    vertices = np.stack([x + jitter[0], rng.uniform(-0.2, 0.2, x.shape), z + jitter[1]], axis=2).reshape(-1, 3)
    mesh = TriangleMesh(vertices=vertices.astype(np.float32), faces=wavy_sheet(2 * (number - 1) ** 2).faces)
    camera = Camera.look_at(np.array([0.0, -6, 0]), np.zeros(3), vertical_fov_deg=35.0)
    assert (Renderer(mesh, RenderSettings(width=400, height=400)).buffers(camera).face >= 0).all()
