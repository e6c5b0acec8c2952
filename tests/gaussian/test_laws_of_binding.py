"""Laws of what hangs on a mesh, and of how it moves with it."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import polar
from scipy.spatial.transform import Rotation

from benchmarks._gaussian_scene import wavy_sheet
from dynamictree.errors import InputError
from dynamictree.gaussian.binding import STILL, Binding, bind, bind_to_faces, solid_faces
from dynamictree.gaussian.cloud import GaussianCloud, in_box
from dynamictree.gaussian.deform import Deformer, Pose, apply_pose
from dynamictree.gaussian.deform_kernel import COLLAPSED, MAX_STRETCH
from dynamictree.gaussian.harmonics import harmonics
from dynamictree.gaussian.turn import harmonic_values, turn_sh_fast
from dynamictree.gaussian.vector_rows import CACHE_LINE_BYTES
from dynamictree.mesh import TriangleMesh
from dynamictree.rotation import quaternion_matrices
from tests.clouds import cloud_at
from tests.formats.test_cloud_round_trips import covariances


@pytest.fixture(scope="module")
def mesh() -> TriangleMesh:
    """A bent sheet, 5 m from the origin."""
    x, y = np.meshgrid(np.linspace(0, 2, 24), np.linspace(0, 2, 24), indexing="ij")
    vertices = np.stack([x + 5, y, 0.3 * np.sin(3 * x) * np.cos(2 * y)], axis=-1).reshape(-1, 3).astype(np.float32)
    return TriangleMesh(vertices=vertices, faces=wavy_sheet(2 * 23**2).faces)


@pytest.fixture(scope="module")
def cloud(mesh: TriangleMesh) -> GaussianCloud:
    rng = np.random.default_rng(5)
    count = 1000  # no whole number of blocks
    quaternions = rng.normal(size=(count, 4))
    near = mesh.vertices[rng.integers(0, mesh.num_vertices, count)] + rng.normal(size=(count, 3)) * 0.01
    return cloud_at(
        near,
        turned=quaternions,
        scale=np.exp(rng.normal(size=(count, 3)) - 5),
        opacity=rng.uniform(0.1, 1, count),
        sh=rng.normal(size=(count, 16, 3)),
    )


@pytest.fixture(scope="module")
def binding(cloud: GaussianCloud, mesh: TriangleMesh) -> Binding:
    return bind(cloud, mesh)


def sway(vertices: np.ndarray) -> np.ndarray:
    return (0.3 * np.sin(2 * vertices[:, [1, 2, 0]])).astype(np.float32)


def test_at_rest_the_cloud_comes_back(binding: Binding, cloud: GaussianCloud) -> None:
    pose = Deformer(binding).pose(np.zeros_like(binding.vertices))
    for name, rtol, atol in (("means", 2e-7, 1e-6), ("quaternions", 1e-7, 5e-7), ("scales", 5e-7, 0)):
        np.testing.assert_allclose(getattr(pose, name), getattr(cloud, name), rtol=rtol, atol=atol)
    back = apply_pose(cloud, pose)
    np.testing.assert_allclose(back.sh, cloud.sh, atol=2e-5)
    assert back.opacity is cloud.opacity


@pytest.mark.parametrize("turn", ["random", "half", "tiny"])
def test_a_rigid_motion_moves_it_rigidly_colours_too(binding: Binding, cloud: GaussianCloud, turn: str) -> None:
    vector = {"random": [0.7, -1.1, 2.0], "half": [0, np.pi, 0], "tiny": [1e-6, 0, 0]}[turn]
    rotation, shift = Rotation.from_rotvec(vector).as_matrix(), np.array([1.0, -2.0, 3.0])
    displacement = (binding.vertices @ rotation.T + shift - binding.vertices).astype(np.float32)
    moved = apply_pose(cloud, Deformer(binding).pose(displacement))
    np.testing.assert_allclose(moved.means, cloud.means @ rotation.T + shift, atol=1e-5)
    np.testing.assert_allclose(moved.scales, cloud.scales, rtol=1e-4)
    np.testing.assert_allclose(covariances(moved), rotation @ covariances(cloud) @ rotation.T, rtol=1e-3, atol=2e-7)
    eye = np.array([[0.6, 0.0, 0.8]])
    seen = np.einsum("dh,ghc->gdc", harmonics(eye, 3), cloud.sh)
    seen_after = np.einsum("dh,ghc->gdc", harmonics(eye @ rotation.T, 3), moved.sh)
    np.testing.assert_allclose(seen_after, seen, atol=2e-3)


def with_normal(corners: np.ndarray) -> tuple[np.ndarray, bool]:
    """Two edges of a face and its unit normal as columns, and whether the face has collapsed."""
    first, second = corners[1] - corners[0], corners[2] - corners[0]
    normal = np.cross(first, second)
    area = np.linalg.norm(normal)
    collapsed = area <= COLLAPSED * (first @ first + second @ second)
    return np.stack([first, second, normal / max(area, 1e-300)], axis=1), bool(collapsed)


def deformation(rest: np.ndarray, moved: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """F of a face and the rotation of its polar decomposition; a face that collapsed turns as its longer edge does."""
    before, (after, collapsed) = with_normal(rest)[0], with_normal(moved)
    if not collapsed:
        gradient = after @ np.linalg.inv(before)
        return gradient, polar(gradient)[0]
    longer = np.argmax((after[:, :2] ** 2).sum(axis=0))
    rotation = np.eye(3)
    if after[:, longer].any():
        rotation = Rotation.align_vectors([after[:, longer]], [before[:, longer]])[0].as_matrix()
    after[:, 2] = rotation @ before[:, 2]
    return after @ np.linalg.inv(before), rotation


def test_a_pose_is_that_of_each_faces_polar_decomposition(binding: Binding, cloud: GaussianCloud, rng) -> None:
    deformer = Deformer(binding)
    for displacement in (
        sway(binding.vertices),
        rng.normal(size=binding.vertices.shape).astype(np.float32),
        (binding.vertices * [0, -1, -1]).astype(np.float32),  # all onto a line
        -binding.vertices,  # all onto a point
    ):
        pose = deformer.pose(displacement)
        for g in range(0, cloud.num_gaussians, 3):
            face = binding.triangles[binding.face_of[g]]
            rest = binding.vertices[face].astype(np.float64)
            moved = rest + displacement[face]
            gradient, rotation = deformation(rest, moved)
            offset = cloud.means[g] - binding.weights[g].astype(np.float64) @ rest
            mean = binding.weights[g].astype(np.float64) @ moved + rotation @ offset
            np.testing.assert_allclose(pose.means[g], mean, atol=3e-6)
            own, now = quaternion_matrices(np.stack([cloud.quaternions[g], pose.quaternions[g]]).astype(np.float64))
            np.testing.assert_allclose(now, rotation @ own, atol=2e-4)
            stretch = np.clip(np.linalg.norm(gradient @ own, axis=0), 1 / MAX_STRETCH, MAX_STRETCH)
            np.testing.assert_allclose(pose.scales[g], cloud.scales[g] * stretch, rtol=2e-3)


def test_a_pose_is_the_same_wherever_it_is_written(binding: Binding) -> None:
    """Memory at a cache line is written past the caches, other memory through them."""
    count, deformer = binding.cloud.num_gaussians, Deformer(binding)
    whole = np.empty((10, 3 * count + 1), np.float32)
    means, quaternions, scales = (
        memory[1 : 1 + width * count].reshape(count, width)
        for memory, width in zip((whole[0], whole[2:4].ravel(), whole[5]), (3, 4, 3), strict=True)
    )
    out = Pose(means=means, quaternions=quaternions, scales=scales)
    beside = deformer.pose(sway(binding.vertices), out=out)
    assert beside is out
    aligned = deformer.pose(sway(binding.vertices))
    for name in ("means", "quaternions", "scales"):
        assert getattr(aligned, name).ctypes.data % CACHE_LINE_BYTES == 0
        assert getattr(beside, name).ctypes.data % CACHE_LINE_BYTES != 0
        np.testing.assert_array_equal(getattr(beside, name), getattr(aligned, name))


def test_a_motion_is_without_jumps(binding: Binding) -> None:
    turns = Rotation.from_rotvec(np.outer(np.linspace(0, np.pi * 0.95, 60), [0, 1, 0])).as_matrix()
    motion = [(binding.vertices @ turn.T - binding.vertices).astype(np.float32) for turn in turns]
    deformer = Deformer(binding)
    assert np.abs(np.diff([deformer.pose(moved).quaternions for moved in motion], axis=0)).max() < 0.1


def test_floaters_and_what_the_mask_leaves_out_stay_still(cloud: GaussianCloud, mesh: TriangleMesh) -> None:
    means = cloud.means.copy()
    means[:10] += [0, 0, 3]
    scene = replace(cloud, means=means)
    mask = in_box(scene.means, ((4.9, -1.0, -1.0), (6.0, 3.0, 5.0)))
    binding = bind(scene, mesh, mask=mask)
    assert (binding.face_of[:10] == STILL).all()
    assert (binding.face_of[~mask] == STILL).all()
    assert (binding.face_of[mask & (np.arange(1000) >= 10)] != STILL).all()
    pose = Deformer(binding).pose(sway(mesh.vertices))
    still = ~binding.moving
    for name in ("means", "scales", "quaternions"):
        np.testing.assert_array_equal(getattr(pose, name)[still], getattr(scene, name)[still])
    assert np.abs(pose.means[binding.moving] - scene.means[binding.moving]).max() > 0.05


def test_gaussians_made_on_a_face_stay_on_it(mesh: TriangleMesh, cloud: GaussianCloud, rng) -> None:
    faces = rng.integers(0, mesh.num_faces, cloud.num_gaussians).astype(np.int32)
    weights = rng.dirichlet([1, 1, 1], cloud.num_gaussians).astype(np.float32)
    on_faces = replace(cloud, means=np.einsum("gc,gcx->gx", weights, mesh.vertices[mesh.faces[faces]]))
    binding = bind_to_faces(on_faces, mesh, faces, weights)
    moved = mesh.vertices + sway(mesh.vertices)
    pose = Deformer(binding).pose(sway(mesh.vertices))
    np.testing.assert_allclose(pose.means, np.einsum("gc,gcx->gx", weights, moved[mesh.faces[faces]]), atol=3e-6)


def test_what_cannot_be_bound_is_reported(cloud: GaussianCloud, mesh: TriangleMesh, binding: Binding) -> None:
    far = replace(cloud, means=cloud.means + np.float32(100))
    with pytest.raises(InputError, match="same axes and units"):
        bind(far, mesh)
    line = TriangleMesh(vertices=np.eye(3, dtype=np.float32), faces=np.array([[0, 1, 1]], np.int32))
    with pytest.raises(InputError, match="none of the mesh's 1 faces"):
        solid_faces(line)
    with pytest.raises(InputError, match="low corner"):
        in_box(cloud.means, ((0.0, 0.0, 0.0), (1.0, 0.0, 1.0)))
    with pytest.raises(InputError, match="displacement is of 3 vertices"):
        Deformer(binding).pose(np.zeros((3, 3), np.float32))
    with pytest.raises(InputError, match="rows for"):
        replace(binding, face_of=binding.face_of[:5], weights=binding.weights[:5])
    with pytest.raises(InputError, match="names face"):
        replace(binding, face_of=binding.face_of + len(binding.triangles))
    with pytest.raises(InputError, match="outside of the"):
        replace(binding, triangles=binding.triangles + mesh.num_vertices)


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_compiled_harmonics_are_those_of_scipy(rng, degree: int) -> None:
    sh = rng.normal(size=(1, (degree + 1) ** 2, 3)).astype(np.float32)
    np.testing.assert_array_equal(turn_sh_fast(sh, np.float32([[1, 0, 0, 0]])), sh)
    directions = Rotation.random(50, rng=rng).as_matrix()[:, 0].astype(np.float32)
    values = np.zeros((50, 16), np.float32)
    for direction, row in zip(directions, values, strict=True):
        harmonic_values(degree, *direction, row)
    np.testing.assert_allclose(values[:, : (degree + 1) ** 2], harmonics(directions, degree), atol=1e-6)


def test_a_large_gaussian_hangs_on_the_surface_that_it_reaches_and_the_sky_on_none() -> None:
    mesh = TriangleMesh(
        vertices=np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], np.float32),
        faces=np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]], np.int32),
    )
    cloud = cloud_at(
        np.array([[0.4, 0.4, -0.3], [0.4, 0.4, -0.3], [0.4, 0.4, -8.0]]), scale=[[0.2] * 3, [0.1] * 3, [5.0] * 3]
    )
    assert bind(cloud, mesh).moving.tolist() == [True, False, False]
