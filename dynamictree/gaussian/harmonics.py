"""Real spherical harmonics to degree 3: values, and rotation of coefficients."""

from functools import cache

import numpy as np
from jaxtyping import Float, Float32, Float64

SH_0 = 0.28209479177387814  # sqrt(1 / 4π)
_SH_1 = 0.4886025119029199  # sqrt(3 / 4π)
_SH_2 = (1.0925484305920792, 0.31539156525252005, 0.5462742152960396)  # sqrt(15/4π), sqrt(5/16π), sqrt(15/16π)
_SH_3 = (0.5900435899266435, 2.890611442640554, 0.4570457994644658, 0.3731763325901154, 1.445305721320277)
SH_CONSTANTS = (SH_0, _SH_1, *_SH_2, *_SH_3)


def harmonics(directions: Float[np.ndarray, "M 3"], degree: int) -> Float[np.ndarray, "M H"]:
    """Compute Y_h at unit directions, h = l² + l + m, with the signs of Kerbl et al. 2023 (Condon-Shortley phase)."""
    x, y, z = directions.T
    values = [np.full_like(x, SH_0)]
    if degree >= 1:
        values += [-_SH_1 * y, _SH_1 * z, -_SH_1 * x]
    if degree >= 2:
        a, b, c = _SH_2
        values += [a * x * y, -a * y * z, b * (2 * z * z - x * x - y * y), -a * x * z, c * (x * x - y * y)]
    if degree >= 3:
        a, b, c, d, e = _SH_3
        values += [
            -a * y * (3 * x * x - y * y),
            b * x * y * z,
            -c * y * (4 * z * z - x * x - y * y),
            d * z * (2 * z * z - 3 * x * x - 3 * y * y),
            -c * x * (4 * z * z - x * x - y * y),
            e * z * (x * x - y * y),
            -a * x * (x * x - 3 * y * y),
        ]
    return np.stack(values, axis=1)


@cache
def sample_directions(degree: int) -> Float64[np.ndarray, "D 3"]:
    """Return 2l + 1 directions at which the harmonics of degree l are independent: a spiral from pole to equator."""
    count = 2 * degree + 1
    place = (np.arange(count) + 0.5) / count
    z, angle = 1 - place * 0.95, np.pi * (3 - np.sqrt(5)) * np.arange(count)
    radius = np.sqrt(1 - z * z)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), z], axis=1)


@cache
def sample_inverse(degree: int) -> Float64[np.ndarray, "D D"]:
    """Return the matrix from values of a function of degree l at `sample_directions` to its 2l + 1 coefficients."""
    return np.linalg.inv(harmonics(sample_directions(degree), degree)[:, degree**2 :])


def turn_matrices(rotations: Float[np.ndarray, "G 3 3"], degree: int) -> Float64[np.ndarray, "G D D"]:
    """Compute the rotation matrices of one degree's coefficients, from f'(d) = f(Rᵀ d) at enough directions d."""
    seen = sample_directions(degree) @ rotations.astype(np.float64)  # Rᵀ d as rows [G, D, 3]
    values = harmonics(seen.reshape(-1, 3), degree)[:, degree**2 :].reshape(*seen.shape[:2], -1)  # [G, D, D]
    result: Float64[np.ndarray, "G D D"] = sample_inverse(degree) @ values
    return result


def turn_sh(sh: Float32[np.ndarray, "G H 3"], rotations: Float[np.ndarray, "#G 3 3"]) -> Float32[np.ndarray, "G H 3"]:
    """Rotate the coefficients of each Gaussian by its rotation (or all by one).

    This is the reference implementation of `turn.turn_sh_fast`.
    """
    turned = sh.copy()
    for degree in range(1, round(sh.shape[1] ** 0.5)):
        band = slice(degree**2, (degree + 1) ** 2)
        turned[:, band] = turn_matrices(rotations, degree) @ sh[:, band]
    return turned
