"""A skin that is fitted to a motion that few joints can make finds it again."""

from itertools import combinations

import numpy as np
import pytest

from dynamictree.mesh import TriangleMesh
from dynamictree.modal.fitted_skin import fitted_skin
from dynamictree.modal.skin_weights import skin_weights


def cloud(rng: np.random.Generator, count: int) -> TriangleMesh:
    vertices = rng.normal(size=(count, 3)).astype(np.float32)
    return TriangleMesh(vertices=vertices, faces=np.arange(3 * (count // 3), dtype=np.int32).reshape(-1, 3))


def test_parts_that_slide_are_carried_exactly_and_what_rests_stays(rng: np.random.Generator) -> None:
    mesh = cloud(rng, 90)
    slides = rng.normal(size=(3, 3)) + 1j * rng.normal(size=(3, 3))
    coefficients = np.zeros((90, 4, 3), np.complex64)
    coefficients[:30, 1], coefficients[30:60, 3] = 0.1 * slides[0], 0.1 * slides[1]
    skin, summary = fitted_skin(mesh, coefficients, num_frames=40, num_joints=32)
    assert summary.max_error_m < 1e-3
    assert summary.num_joints <= 32
    assert all(not skin.displacement(mesh.vertices, frame)[60:].any() for frame in range(40))
    np.testing.assert_allclose(skin.weights.sum(axis=1), 1, atol=1e-6)
    assert (skin.weights >= 0).all()


def test_a_mesh_at_rest_hangs_on_the_root_alone(rng: np.random.Generator) -> None:
    skin, summary = fitted_skin(cloud(rng, 30), np.zeros((30, 3, 3), np.complex64), num_frames=10, num_joints=64)
    assert (summary.num_joints, summary.max_error_m, skin.parent.tolist()) == (1, 0.0, [-1])


def test_the_fit_reports_its_progress_and_ends_where_the_report_raises(rng: np.random.Generator) -> None:
    mesh = cloud(rng, 90)
    coefficients = (0.1 * rng.normal(size=(90, 4, 3))).astype(np.complex64)
    shares: list[float] = []
    fitted_skin(mesh, coefficients, num_frames=40, num_joints=8, on_progress=shares.append)
    assert shares == sorted(shares)
    assert len(set(shares)) > 8
    assert 0 <= shares[0] < 0.1
    assert 0.5 < shares[-1] <= 1

    def cancel(done: float) -> None:
        if done > 0.2:
            raise InterruptedError

    with pytest.raises(InterruptedError):
        fitted_skin(mesh, coefficients, num_frames=40, num_joints=8, on_progress=cancel)


def test_weights_of_up_to_four_joints_are_found_again(rng: np.random.Generator) -> None:
    points, num_frames, num_joints = rng.normal(size=(40, 3)), 9, 7
    rotation = np.tile(np.eye(3), (num_frames, num_joints, 1, 1))
    translation = rng.normal(size=(num_frames, num_joints, 3))
    truth = np.zeros((40, num_joints))
    for row in truth:
        row[rng.choice(num_joints, 4, replace=False)] = rng.dirichlet(np.ones(4))
    targets = points + np.einsum("nb,tbi->tni", truth, translation)
    rows, weights = skin_weights(points, targets, rotation, translation)
    recovered = np.zeros_like(truth)
    np.add.at(recovered, (np.arange(40)[:, None], rows), weights)
    np.testing.assert_allclose(recovered, truth, atol=1e-4)


def test_weights_are_the_best_of_all_sets_of_joints(rng: np.random.Generator) -> None:
    """Against a slow search: every set of four, weights on a grid."""
    rotation, translation = np.tile(np.eye(3), (5, 6, 1, 1)), rng.normal(size=(5, 6, 3))
    targets = rng.normal(size=(5, 1, 3))
    rows, weights = skin_weights(np.zeros((1, 3)), targets, rotation, translation)
    error = ((np.einsum("w,twi->ti", weights[0], translation[:, rows[0]]) - targets[:, 0]) ** 2).sum()
    steps = [w for w in np.ndindex(11, 11, 11) if sum(w) <= 10]
    grid = np.array([(*w, 10 - sum(w)) for w in steps]) / 10
    least = min(
        ((np.einsum("gw,twi->gti", grid, translation[:, list(four)]) - targets[:, 0]) ** 2).sum(axis=(1, 2)).min()
        for four in combinations(range(6), 4)
    )
    assert error <= least * (1 + 1e-9)
    assert error == pytest.approx(least, rel=0.1)
