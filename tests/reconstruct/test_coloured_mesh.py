"""Stereo, fusion and colours on pictures whose cameras and depths are exact."""

from dataclasses import replace

import numpy as np
import pytest
from PIL import Image
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from dynamictree.errors import ReconstructionError
from dynamictree.mesh import Surface, TriangleMesh
from dynamictree.reconstruct.coloured_mesh import finished_mesh, photo_colors, stereo_surface
from dynamictree.reconstruct.depth import stereo_view
from dynamictree.reconstruct.fusion import Box, faces_above, fuse, main_cluster
from dynamictree.reconstruct.scene import find_scene
from dynamictree.reconstruct.stereo import Hypotheses, agreed_depths, match_view, neighbours_of
from dynamictree.reconstruct.upright_frame import camera_up, find_upright_frame
from dynamictree.reconstruct.views import SparseModel, View
from dynamictree.render import Renderer, RenderSettings
from tests.reconstruct.conftest import Orbit, sparse_model

SIDE, BOUNDS = 220, (1.5, 6.0)


def views_of(orbit: Orbit) -> tuple[View, ...]:
    photos = zip(orbit.photos, orbit.cameras, strict=True)
    return tuple(View(source=path.name, image=np.array(Image.open(path)), camera=camera) for path, camera in photos)


def exact_depths(orbit: Orbit, shape: tuple[int, int]) -> list[np.ndarray]:
    renderer = Renderer(orbit.stump, RenderSettings(width=shape[1], height=shape[0]))
    depths = [renderer.buffers(camera).depth_m for camera in orbit.cameras]
    return [np.where(np.isfinite(depth), depth, 0).astype(np.float32) for depth in depths]


def model_of(orbit: Orbit, rng: np.random.Generator) -> SparseModel:
    """Points on the stump and on the ground, as structure from motion would give them."""
    on_stump = orbit.stump.vertices[rng.integers(0, orbit.stump.num_vertices, 600)].astype(np.float64)
    on_ground = np.concatenate([rng.uniform(-2, 2, (400, 2)), np.zeros((400, 1))], axis=1)
    points = np.concatenate([on_stump, on_ground]) + rng.normal(scale=0.002, size=(1000, 3))
    views = views_of(orbit)
    seen = np.stack(np.meshgrid(np.arange(len(views)), np.arange(1000), indexing="ij"), axis=2).reshape(-1, 2)
    return sparse_model(views, points, seen[rng.random(len(seen)) < 0.4])


def flat(shape: tuple[int, int]) -> Hypotheses:
    """3 m everywhere; the truth runs from 2.4 to 8."""
    inverse, slope, cost = np.full(shape, 1 / 3), np.zeros((*shape, 2)), np.full(shape, 3)
    return Hypotheses(inverse.astype(np.float32), slope.astype(np.float32), cost.astype(np.float32))


def test_stereo_finds_the_depth_that_the_renderer_has(orbit):
    views = [stereo_view(view, 150) for view in views_of(orbit)[:3]]
    shape = views[0].grey.shape
    guess, everywhere = flat(shape), np.ones(shape, bool)
    others = [[1, 2], [0, 2], [0, 1]]
    planes = [match_view([views[o] for o in (v, *others[v])], guess, BOUNDS, everywhere, seed=v) for v in range(3)]
    agreed = agreed_depths(views, planes, others, min_agreeing=1)[0]
    truth = exact_depths(orbit, shape)[0]
    inner = truth > 0
    inner[:-4] &= inner[4:]
    inner[:, 4:-4] &= inner[:, 8:] & inner[:, :-8]
    sure = inner & (agreed > 0)
    assert sure.sum() > 0.6 * inner.sum()
    assert np.median(np.abs(agreed - truth)[sure] / truth[sure]) < 0.003
    assert np.percentile(np.abs(agreed - truth)[sure] / truth[sure], 90) < 0.02


def test_stereo_is_the_same_in_every_run_and_leaves_the_masked_alone(orbit):
    views = [stereo_view(view, 120) for view in views_of(orbit)[:2]]
    mask = np.zeros(views[0].grey.shape, bool)
    mask[30:60, 40:80] = True
    runs = [match_view(views[:2], flat(mask.shape), BOUNDS, mask, num_iterations=2) for _ in range(2)]
    assert np.array_equal(runs[0].inverse, runs[1].inverse)
    assert (runs[0].inverse[~mask] == np.float32(1 / 3)).all()
    assert (runs[0].cost[mask] <= 2).all()


def test_neighbours_see_the_same_points_from_a_little_aside():
    turns = np.radians([0, 1, 12, 40, 90])
    positions = np.stack([5 * np.cos(turns), 5 * np.sin(turns), np.zeros(5)], axis=1)
    points = np.random.default_rng(0).normal(scale=0.3, size=(50, 3))
    seen = np.array([(view, point) for view in range(4) for point in range(50)])
    neighbours = neighbours_of(positions, points, seen)
    assert neighbours[0][0] == 2
    assert 4 not in neighbours[0]  # shares no point
    assert neighbours[4] == []


def test_exact_depths_fuse_to_the_surface_with_faces_outward(orbit):
    views = [stereo_view(view, SIDE) for view in views_of(orbit)]
    depths = exact_depths(orbit, views[0].grey.shape)
    box = Box(low=np.array([-0.7, -0.7, 0.0]), high=np.array([0.7, 0.7, 1.4]))
    surface = main_cluster(fuse(views, depths, box, resolution=70), 0.05)
    true_surface = orbit.stump.vertices[orbit.stump.faces].mean(axis=1)
    distance = cKDTree(true_surface).query(surface.vertices)[0]
    assert np.percentile(distance, 95) < 2.0 * 1.4 / 70
    side = true_surface[(true_surface[:, 2] > 0.1) & (true_surface[:, 2] < 1.1)]
    assert np.percentile(cKDTree(surface.vertices).query(side)[0], 95) < 2.0 * 1.4 / 70
    a, b, c = (surface.vertices[surface.faces[:, corner]] for corner in range(3))
    outward = (np.cross(b - a, c - a)[:, :2] * a[:, :2]).sum(axis=1) > 0
    upright = (a[:, 2] > 0.1) & (a[:, 2] < 1.0)
    assert outward[upright].mean() > 0.98


def strip(start: float, num_faces: int, height: float) -> Surface:
    """A band of triangles along x, half a metre a triangle."""
    number = num_faces + 2
    vertices = np.stack([start + 0.5 * np.arange(number), np.arange(number) % 2, np.full(number, height)], axis=1)
    faces = np.stack([np.arange(num_faces), np.arange(1, num_faces + 1), np.arange(2, num_faces + 2)], axis=1)
    return Surface(vertices=vertices.astype(np.float32), faces=faces.astype(np.int32))


def together(*surfaces: Surface) -> Surface:
    starts = np.cumsum([0, *(len(surface.vertices) for surface in surfaces[:-1])])
    faces = [surface.faces + start for surface, start in zip(surfaces, starts, strict=True)]
    return Surface(
        vertices=np.concatenate([s.vertices for s in surfaces]), faces=np.concatenate(faces).astype(np.int32)
    )


def test_pieces_that_are_near_stay_and_far_ones_and_specks_go():
    trunk, twig, speck, rock = strip(0, 100, 0), strip(52, 30, 2), strip(20, 5, 1), strip(200, 60, 0)
    cluster = main_cluster(together(trunk, twig, speck, rock), gap=3.0)
    assert np.array_equal(cluster.vertices, np.concatenate([trunk.vertices, twig.vertices]))
    assert len(cluster.faces) == 130
    assert len(main_cluster(together(trunk, twig, rock), gap=0.6).faces) == 100
    assert len(main_cluster(speck, gap=3.0).faces) == 0


def test_what_lies_low_is_cut():
    high = faces_above(together(strip(0, 10, 0.5), strip(0, 12, 2)), 1.0)
    assert np.array_equal(high.vertices, strip(0, 12, 2).vertices)
    assert np.array_equal(high.faces, strip(0, 12, 2).faces)
    assert len(main_cluster(faces_above(high, 9.0), 1.0).faces) == 0


def test_the_stage_stands_on_the_ground_whatever_the_frame(orbit, rng):
    model = model_of(orbit, rng)
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))
    moved = model.transformed(0.37, turn, np.array([3.0, -2, 5]))
    stage = find_upright_frame(moved, np.random.default_rng(0))
    assert stage.ground_found
    assert stage.up @ (turn @ [0, 0, 1]) > np.cos(np.radians(1))
    ground = 0.37 * turn @ (np.array([0.0, 0, 0]) - [3.0, -2, 5])
    assert abs((stage.origin - ground) @ stage.up) < 0.01 * 0.37
    assert np.linalg.norm(stage.origin - ground) < 0.25 * 0.37
    upright = moved.transformed(1 / stage.radius, stage.rotation, stage.origin)
    assert all(view.camera.position_m[2] > 0 for view in upright.views)
    assert all(-view.camera.world_to_camera[1, 2] > 0.5 for view in upright.views)


def with_points(model: SparseModel, *parts: np.ndarray) -> SparseModel:
    points = np.concatenate(parts)
    return replace(model, points=points, colors=np.zeros((len(points), 3), np.uint8))


def test_a_plane_that_leans_away_from_level_photos_is_no_ground(orbit, rng):
    """A leaf with a tenth of the points won over cameras that agree, and up was 10 degrees off."""
    model = model_of(orbit, rng)
    standing = model.points[model.points[:, 2] > 0.1]
    level = rng.uniform(-0.4, 0.4, (len(standing) // 8, 3)) * [1, 1, 0]
    leaf = Rotation.from_euler("x", 9.6, degrees=True).apply(level) - [0, 0, 0.05]
    stage = find_upright_frame(with_points(model, standing, leaf), np.random.default_rng(0))
    assert stage.up[2] > np.cos(np.radians(2))


def test_a_slope_with_most_of_the_points_is_ground(orbit, rng):
    model = model_of(orbit, rng)
    lean = Rotation.from_euler("x", 10, degrees=True)
    ground = lean.apply(rng.uniform(-2, 2, (2000, 3)) * [1, 1, 0])
    high = model.points[model.points[:, 2] > 0.5]
    stage = find_upright_frame(with_points(model, high, ground), np.random.default_rng(0))
    assert stage.ground_found
    assert stage.up @ lean.apply([0, 0, 1]) > np.cos(np.radians(1))


def test_up_is_level_whatever_the_pitch(orbit):
    """Photos of one side, all looking down: their mean up leans, their right axes are level."""
    cameras = [camera for camera in orbit.cameras if camera.position_m[0] > 0]
    rotations = np.array([camera.world_to_camera for camera in cameras])
    up, agree = camera_up(np.array([camera.position_m for camera in cameras]), rotations)
    assert agree
    assert up[2] > np.cos(np.radians(1))
    mean_up = -rotations[:, 1].sum(axis=0)
    assert mean_up[2] / np.linalg.norm(mean_up) < np.cos(np.radians(5))


def test_without_ground_up_is_the_cameras_own(orbit, rng):
    model = model_of(orbit, rng)
    few = sparse_model(model.views, model.points[model.points[:, 2] > 0.05][:40])
    stage = find_upright_frame(few, np.random.default_rng(0))
    assert not stage.ground_found
    assert stage.up[2] > 0.95


def test_colours_are_those_of_the_photos_that_see_a_vertex(orbit):
    plain = TriangleMesh(vertices=orbit.stump.vertices, faces=orbit.stump.faces)
    view = views_of(orbit)[0]
    height, width = view.image.shape[:2]
    x, y, depth = view.camera.project(plain.vertices, width, height).T
    nearest = Renderer(plain, RenderSettings(width=width, height=height)).buffers(view.camera).depth_m
    visible = depth < nearest[y.astype(int), x.astype(int)] + 0.001
    inner = visible & (plain.vertices[:, :2] @ view.camera.position_m[:2] > 0.7) & (plain.vertices[:, 2] < 1.1)
    assert inner.sum() > 300
    one = photo_colors(plain, (view,))
    assert np.array_equal(one[inner, :3], view.image[y[inner].astype(int), x[inner].astype(int)])
    assert (one[:, 3] == 255).all()
    # those behind take over a colour that is seen
    seen = {tuple(color) for color in view.image.reshape(-1, 3).tolist()}
    assert all(tuple(color) in seen for color in one[~visible, :3].tolist())
    # more photos blend, so a vertex keeps to what the photos around it show
    many = photo_colors(plain, views_of(orbit)).astype(int)
    assert np.abs(many[inner, :3].mean(axis=0) - one[inner, :3].mean(axis=0)).max() < 60


def test_photos_without_any_pattern_show_no_surface(orbit, rng):
    model = model_of(orbit, rng)
    blank = tuple(
        View(source=view.source, image=np.full((90, 120, 3), 128, np.uint8), camera=view.camera) for view in model.views
    )
    scene = find_scene(replace(model, views=blank))
    with pytest.raises(ReconstructionError, match=r"14 photos fit together, but they agree on 0 triangles"):
        finished_mesh(stereo_surface(scene), scene)


def test_what_masks_show_remains_where_stereo_sees_only_a_part(orbit, rng):
    model = model_of(orbit, rng)
    views = []
    for view, depth in zip(model.views, exact_depths(orbit, (90, 120)), strict=True):
        image = np.array(Image.fromarray(view.image).resize((120, 90), Image.Resampling.BOX))
        cut = np.where(depth > 0, 255, 0).astype(np.uint8)
        views.append(View(source=view.source, image=image, camera=view.camera, alpha=cut))
    assert find_scene(replace(model, views=tuple(views))).subject is None
