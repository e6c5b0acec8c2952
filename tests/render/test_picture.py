from dataclasses import replace

import numpy as np
import pytest

from dynamictree.color import linear_from_bytes
from dynamictree.errors import FormatError, InputError, MeshError
from dynamictree.mesh import Material, MeshLook, TriangleMesh
from dynamictree.render import Camera, Renderer, RenderSettings
from dynamictree.render import shade as light
from dynamictree.render.appearance import foliage_faces
from dynamictree.render.camera import points_in_view
from tests.formats.meshes import png_of
from tests.render.conftest import facing_card
from tests.render.test_raster import cast_rays

FRONT = Camera.look_at(np.array([0.0, -6, 0]), np.zeros(3), vertical_fov_deg=35.0)
PLAIN = RenderSettings(width=64, height=64, ground=False, shadows=False)


def render_mesh(mesh: TriangleMesh, camera: Camera | None = None, *, look: RenderSettings | None = None) -> np.ndarray:
    return Renderer(mesh, look).picture(camera=camera)


def psnr_db(first: np.ndarray, second: np.ndarray) -> float:
    error = np.mean((first.astype(np.float64) - second) ** 2)
    return float(10 * np.log10(255**2 / error)) if error > 0 else np.inf


def srgb(value: np.ndarray) -> np.ndarray:
    clipped = np.clip(value, 0, 1)
    return np.where(clipped <= 0.0031308, 12.92 * clipped, 1.055 * clipped ** (1 / 2.4) - 0.055) * 255


def slow_picture(mesh: TriangleMesh, camera: Camera, size: int, sun: tuple[float, float, float]) -> np.ndarray:
    """Ray casting in float64, one sample a pixel: flat Lambert of the face under sun and sky; no shadows, no ground."""
    _, face = cast_rays(mesh, camera, size)
    a, b, c = (mesh.vertices[mesh.faces[:, corner]].astype(np.float64) for corner in range(3))
    normals = np.cross(b - a, c - a)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    normals[((a - camera.position_m) * normals).sum(axis=1) > 0] *= -1
    albedo = linear_from_bytes(mesh.look.vertex_colors[mesh.faces[:, 0], :3])
    direct = np.clip(normals @ (np.array(sun) / np.linalg.norm(sun)), 0, None)[:, None]
    dome = (0.5 + 0.5 * normals[:, 2])[:, None]
    lit = albedo * (direct * light._SUN + dome * light._SKY + (1 - dome) * light._BOUNCE)
    column, row = np.meshgrid(np.arange(size) + 0.5, np.arange(size) + 0.5)
    rays = np.stack([column, row, np.ones_like(row)], axis=2) @ np.linalg.inv(camera.intrinsics_px(size, size)).T
    rays = rays @ camera.world_to_camera
    up = np.clip(rays[..., 2] / np.linalg.norm(rays, axis=2), 0, None)[..., None]
    sky = light._HORIZON + (1 - np.exp(-4 * up)) * (np.array(light._ZENITH) - light._HORIZON)
    return srgb(np.where((face >= 0)[..., None], lit[face], sky))


def test_agrees_with_a_slow_exact_picture(two_balls):
    flat = replace(
        two_balls,
        vertices=two_balls.vertices[two_balls.faces.ravel()],
        look=replace(two_balls.look, vertex_colors=two_balls.look.vertex_colors[two_balls.faces.ravel()]),
        faces=np.arange(two_balls.num_faces * 3, dtype=np.int32).reshape(-1, 3),
    )
    camera = Camera.orbit(flat.vertices, azimuth_deg=-20.0, elevation_deg=15.0)
    look = replace(PLAIN, width=96, height=96, supersampling=1)
    assert psnr_db(render_mesh(flat, camera, look=look), slow_picture(flat, camera, 96, look.sun_direction)) > 45


def test_supersampling_is_the_mean_of_a_finer_picture(two_balls):
    camera = Camera.orbit(two_balls.vertices)
    coarse = Renderer(two_balls, PLAIN).picture(camera=camera)
    fine = Renderer(two_balls, replace(PLAIN, width=128, height=128, supersampling=1)).picture(camera=camera)
    mean = srgb(linear_from_bytes(fine).reshape(64, 2, 64, 2, 3).mean(axis=(1, 3)))
    assert psnr_db(coarse, mean) > 40


def card(material: Material) -> TriangleMesh:
    vertices, faces, uv = facing_card()
    look = MeshLook(uv=uv, face_material=np.zeros(2, np.int32), materials=(material,))
    return TriangleMesh(vertices=vertices, faces=faces, look=look)


def test_a_card_is_cut_out_where_its_texture_is_clear():
    texture = np.zeros((16, 16, 4), np.uint8)
    texture[:, :8] = [0, 200, 0, 255]  # the left half is green, the right half clear
    leaf = Material(base_color=(1.0, 1.0, 1.0, 1.0), texture_png=png_of(texture), alpha_cutoff=0.5)
    face = Renderer(card(leaf), PLAIN).buffers(FRONT).face
    left, right = face[32, 16:31], face[32, 33:48]
    assert (left >= 0).all()
    assert (right == -1).all()
    opaque = Renderer(card(replace(leaf, alpha_cutoff=None)), PLAIN)
    assert (opaque.buffers(FRONT).face[32, 33:48] >= 0).all()


def test_a_texture_lies_as_its_coordinates_say():
    texture = np.zeros((2, 2, 3), np.uint8)
    texture[0, 0], texture[0, 1], texture[1, 0], texture[1, 1] = [255, 0, 0], [0, 255, 0], [0, 0, 255], [255, 255, 0]
    texture = np.repeat(np.repeat(texture, 64, axis=0), 64, axis=1)
    material = Material(base_color=(1.0, 1.0, 1.0, 1.0), texture_png=png_of(texture))
    picture = Renderer(card(material), PLAIN).picture(camera=FRONT).astype(int)
    above_left, above_right, below_left, below_right = picture[[24, 24, 40, 40], [24, 40, 24, 40]]
    assert above_left.argmax() == 0
    assert above_left[1] < 60
    assert above_right.argmax() == 1
    assert above_right[0] < 60
    assert below_left.argmax() == 2
    assert min(below_right[:2]) > 2 * below_right[2]


def test_both_sides_of_a_card_are_lit():
    front = card(Material(base_color=(1.0, 1.0, 1.0, 1.0)))
    back = replace(front, faces=np.ascontiguousarray(front.faces[:, ::-1]))
    camera = Camera.orbit(front.vertices, azimuth_deg=17.0)
    pictures = [Renderer(mesh, PLAIN).picture(camera=camera).astype(int) for mesh in (front, back)]
    assert np.abs(pictures[0] - pictures[1]).max() <= 1


def test_the_shadow_falls_away_from_the_sun():
    roof = np.array([[-1, -1, 2], [1, -1, 2], [1, 1, 2], [-1, 1, 2], [0, 0, 0], [0.01, 0, 0], [0, 0, 0.01]], np.float32)
    mesh = TriangleMesh(vertices=roof, faces=np.array([[0, 1, 2], [0, 2, 3], [4, 5, 6]], np.int32))
    look = RenderSettings(width=160, height=160, sun_direction=(-1.0, 0.0, 1.0))
    camera = Camera.look_at(np.array([0.0, -16, 9]), np.array([0.0, 0, 0]))
    lit, dark = Renderer(mesh, replace(look, shadows=False)), Renderer(mesh, look)
    fall = lit.picture(camera=camera).astype(int).sum(axis=2) - dark.picture(camera=camera).astype(int).sum(axis=2)
    # the sun stands 45 degrees high in −X: the shadow of the roof, 2 m up, lies 2 m along +X
    (x, y, _), (mirrored_x, mirrored_y, _) = camera.project(np.array([[2.0, 0, 0], [-2.5, 0, 0]]), 160, 160)
    assert fall[int(y), int(x)] > 120
    assert fall[int(mirrored_y), int(mirrored_x)] < 30


def test_under_a_crown_the_ground_sees_less_sky(two_balls):
    renderer = Renderer(two_balls, RenderSettings(width=64, height=64))
    under = light.sky_share(renderer._sky, -0.3, 0.5, 0.1)
    beside = light.sky_share(renderer._sky, 1.8, -1.9, 0.1)
    assert under < 0.6 < 0.85 < beside
    assert light.sky_share(renderer._sky, 50.0, 0.0, 0.0) == 1


def test_a_displacement_moves_what_is_seen(two_balls):
    renderer = Renderer(two_balls, PLAIN)
    shift = np.tile(np.float32([0.3, 0, 0]), (two_balls.num_vertices, 1))
    moved = renderer.picture(shift, camera=FRONT)
    other = replace(two_balls, vertices=two_balls.vertices + shift)
    assert np.array_equal(moved, Renderer(other, PLAIN).picture(camera=FRONT))
    assert not np.array_equal(moved, renderer.picture(camera=FRONT))


def test_a_mesh_without_colours_gets_clay_for_wood_and_for_leaves(two_balls):
    bare = replace(two_balls, look=replace(two_balls.look, vertex_colors=None))
    leaves = foliage_faces(bare.faces, bare.num_vertices)
    assert np.flatnonzero(leaves).tolist() == [len(leaves) - 1]
    red, green, blue = render_mesh(bare, look=PLAIN)[32, 32].astype(int)
    assert red > green > blue  # wood is brown
    separate = np.arange(two_balls.num_faces * 3, dtype=np.int32).reshape(-1, 3)
    assert not foliage_faces(separate, separate.size).any(), "separate triangles alone are no leaves"


@pytest.mark.parametrize("size", [{"width": 0}, {"height": 5000}, {"supersampling": 9}])
def test_refuses_a_picture_of_no_or_too_large_size(size):
    with pytest.raises(InputError, match="allowed"):
        RenderSettings(**size)


def test_refuses_a_mesh_without_faces(two_balls):
    with pytest.raises(MeshError, match="0 faces"):
        render_mesh(replace(two_balls, faces=np.zeros((0, 3), np.int32)))


@pytest.mark.parametrize(
    ("texture", "message"),
    [
        (lambda: b"\x89PNG but then nothing", "no picture"),
        (lambda: png_of(np.zeros((8001, 8001), np.bool_)), "8001 x 8001"),
    ],
)
def test_refuses_a_texture_that_is_none_or_has_too_many_pixels(two_balls, texture, message):
    look = replace(
        two_balls.look,
        materials=(Material(texture_png=texture()),),
        face_material=np.zeros(two_balls.num_faces, np.int32),
    )
    with pytest.raises(FormatError, match=message):
        render_mesh(replace(two_balls, look=look))


def test_the_plant_fills_the_picture_whatever_it_stands_on() -> None:
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 0, 1], [-90, -90, 0], [90, -90, 0], [0, 90, 0]], np.float32)
    faces = np.array([[0, 1, 2], [3, 4, 5]], np.int32)
    whole = TriangleMesh(vertices=corners, faces=faces)
    scene = TriangleMesh(vertices=corners, faces=faces, still_faces=np.array([False, True]))
    far, near = (np.linalg.norm(Renderer(mesh, RenderSettings()).camera.position_m) for mesh in (whole, scene))
    assert near < 0.1 * far


def test_a_pot_is_in_the_picture_and_the_sky_above_is_not() -> None:
    points = np.array([[0, 0, 0], [0.2, 0, 1], [-0.3, 0, -0.3], [0.3, 0.1, -0.1], [0, 0, 9], [0.7, 0, 0]])
    assert points_in_view(points, np.arange(6) < 2).tolist() == [True, True, True, True, False, False]
    pot = np.array([False, True])
    corners = np.array([[0, 0, 0], [0.2, 0, 0], [0, 0, 1], [-0.3, 0, -0.3], [0.3, 0, -0.3], [0, 0.1, 0]], np.float32)
    mesh = TriangleMesh(vertices=corners, faces=np.arange(6, dtype=np.int32).reshape(2, 3), still_faces=pot)
    pixels = Renderer(mesh, RenderSettings()).camera.project(corners.astype(np.float64), 100, 100)
    assert ((pixels[:, :2] > 0) & (pixels[:, :2] < 100)).all()
    assert mesh.height_text == "1.3 m"


@pytest.mark.parametrize("kind", ["vertices", "material", "texture"])
def test_what_stands_still_is_drawn_in_grey_if_asked(two_balls: TriangleMesh, kind: str) -> None:
    """The red ball in front stands still: with the option it has no colour, and all else is as before."""
    count = two_balls.num_faces // 2
    still = np.arange(two_balls.num_faces) < count
    mesh = replace(two_balls, still_faces=still)
    if kind != "vertices":
        red = Material(base_color=(0.7, 0.03, 0.02, 1.0))
        if kind == "texture":
            red = Material(texture_png=png_of(np.tile(np.uint8([220, 40, 30]), (4, 4, 1))))
        blue = Material(base_color=(0.02, 0.05, 0.6, 1.0))
        of_face = (~still).astype(np.int32)
        look = replace(mesh.look, vertex_colors=None, materials=(red, blue), face_material=of_face)
        mesh = replace(mesh, look=look)
    plain = Renderer(mesh, PLAIN).picture().astype(int)
    grey = Renderer(mesh, replace(PLAIN, grey_still=True)).picture().astype(int)
    ball = Renderer(mesh, PLAIN).buffers().face
    inside = (ball >= 0) & (ball < count)
    assert inside.sum() > 300
    others = ~inside
    for part in (inside, others):  # whose rims are mixed
        for step in (-1, 1):
            part &= np.roll(part, step, axis=0) & np.roll(part, step, axis=1)
    assert np.median(np.ptp(plain[inside], axis=1)) > 60
    assert np.median(np.ptp(grey[inside], axis=1)) < 25  # the light itself is warm
    assert (grey[others] == plain[others]).all()
