"""Bones that are fitted to a motion that bones can make find it again."""

import numpy as np
import pytest

from dynamictree.modal.branch_skin import _fitted, nearest_rigid_motion
from dynamictree.spectrum import iter_motion


def rotations(rng: np.random.Generator, count: int) -> np.ndarray:
    q, _ = np.linalg.qr(rng.normal(size=(count, 3, 3)))
    return q * np.sign(np.linalg.det(q))[:, None, None]


def test_a_rigid_motion_is_found_exactly(rng: np.random.Generator) -> None:
    points, weights = rng.normal(size=(12, 3)), rng.uniform(0.1, 1, 12)
    turn, shift = rotations(rng, 5), rng.normal(size=(5, 3))
    targets = points @ turn.swapaxes(1, 2) + shift[:, None]
    fitted_turn, fitted_shift = nearest_rigid_motion(points, targets, weights)
    np.testing.assert_allclose(fitted_turn, turn, atol=1e-5)
    np.testing.assert_allclose(fitted_shift, shift, atol=1e-5)


@pytest.mark.parametrize("count", [1, 2])
def test_too_few_points_do_not_turn_at_rest(rng: np.random.Generator, count: int) -> None:
    points = rng.normal(size=(count, 3))
    turn, shift = nearest_rigid_motion(points, np.broadcast_to(points, (3, count, 3)).copy(), np.ones(count))
    np.testing.assert_allclose(turn, np.broadcast_to(np.eye(3), (3, 3, 3)), atol=1e-9)
    np.testing.assert_allclose(shift, 0, atol=1e-9)


def test_rotations_are_proper_even_for_a_mirrored_target(rng: np.random.Generator) -> None:
    points = rng.normal(size=(9, 3))
    turn, _ = nearest_rigid_motion(points, (points * [1, 1, -1])[None], np.ones(9))
    assert np.linalg.det(turn[0]) == pytest.approx(1)


def test_what_two_bones_can_move_is_fitted_within_a_tenth(rng: np.random.Generator) -> None:
    vertices = rng.normal(size=(60, 3)).astype(np.float32)
    blend = np.linspace(0, 1, 60, dtype=np.float32)
    weights = np.stack([1 - blend, blend, 0 * blend, 0 * blend], axis=1)
    rows = np.tile(np.array([0, 1, 0, 0], np.int32), (60, 1))
    swing = np.zeros((60, 3, 3), np.complex64)
    swing[:, 1] = 0.05 * blend[:, None] * np.array([1, 1j, 0])  # bone 1 goes around, bone 0 stays
    rotation, translation = _fitted(np.array([-1, 0], np.int32), rows, weights, vertices, swing, 20)
    truth = np.stack(list(iter_motion(swing, np.arange(20) / 20, 20)))
    carried = [
        weights[:, [bone]] * (vertices @ rotation[:, bone].swapaxes(1, 2) + translation[:, bone][:, None])
        for bone in (0, 1)
    ]
    error = np.linalg.norm(carried[0] + carried[1] - vertices - truth, axis=2)
    assert error.max() < 0.3 * np.linalg.norm(truth, axis=2).max()
    assert np.sqrt((error**2).mean()) < 0.1 * np.sqrt((truth**2).sum(axis=2).mean())
