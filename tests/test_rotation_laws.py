"""Laws of rotations and of harmonics under them."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from dynamictree.errors import InputError
from dynamictree.gaussian.harmonics import harmonics, turn_sh
from dynamictree.gaussian.turn import turn_sh_fast
from dynamictree.rotation import (
    matrix_quaternions,
    quaternion_matrices,
    quaternion_products,
    unit_quaternions,
)


def _rotations(rng: np.random.Generator, count: int) -> np.ndarray:
    """Rotations at random, with none, tiny ones and half turns among them."""
    some = Rotation.random(count - 5, rng=rng).as_matrix()
    near = Rotation.from_rotvec(rng.normal(size=(1, 3)) * 1e-9).as_matrix()
    half = Rotation.from_rotvec(np.pi * np.eye(3)).as_matrix()
    return np.concatenate([some, near, half, np.eye(3)[None]])


def test_a_matrix_becomes_a_quaternion_and_back(rng) -> None:
    rotations = _rotations(rng, 200)
    quaternions = matrix_quaternions(rotations)
    assert (quaternions[:, 0] >= 0).all()
    np.testing.assert_allclose(quaternion_matrices(quaternions), rotations, atol=1e-12)


def test_the_product_turns_by_the_right_one_first(rng) -> None:
    left, right = _rotations(rng, 50), _rotations(rng, 50)[::-1].copy()
    product = quaternion_products(matrix_quaternions(left), matrix_quaternions(right))
    np.testing.assert_allclose(quaternion_matrices(product), left @ right, atol=1e-12)


def test_a_quaternion_without_length_is_refused() -> None:
    with pytest.raises(InputError, match="Gaussian 1"):
        unit_quaternions(np.array([[2, 0, 0, 0], [0, 0, 0, 0]], np.float32))


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_turned_harmonics_show_the_same_to_an_eye_that_turned(rng, degree: int) -> None:
    rotations = _rotations(rng, 40)
    sh = rng.normal(size=(40, (degree + 1) ** 2, 3)).astype(np.float32)
    turned = turn_sh_fast(sh, matrix_quaternions(rotations).astype(np.float32))
    directions = _rotations(rng, 20)[:, 0]
    for i, rotation in enumerate(rotations):
        before = harmonics(directions, degree) @ sh[i]
        after = harmonics(directions @ rotation.T, degree) @ turned[i]
        np.testing.assert_allclose(after, before, atol=2e-5)
        np.testing.assert_allclose(turn_sh(sh[i : i + 1], rotation)[0], turned[i], atol=2e-5)
