"""Real spherical harmonics to degree 3."""

from functools import cache

import numpy as np
from jaxtyping import Float, Float32, Float64
from scipy.special import sph_harm_y

SH_0 = 0.28209479177387814  # sqrt(1 / 4π)
_SH_1 = 0.4886025119029199  # sqrt(3 / 4π)
_SH_2 = (1.0925484305920792, 0.31539156525252005, 0.5462742152960396)  # sqrt(15/4π), sqrt(5/16π), sqrt(15/16π)
_SH_3 = (0.5900435899266435, 2.890611442640554, 0.4570457994644658, 0.3731763325901154, 1.445305721320277)
SH_CONSTANTS = (SH_0, _SH_1, *_SH_2, *_SH_3)


def harmonics(directions: Float[np.ndarray, "M 3"], degree: int) -> Float64[np.ndarray, "M H"]:
    """Compute Y_h at unit directions, h = l² + l + m, with the signs of Kerbl et al. 2023 (Condon-Shortley phase)."""
    of = [(level, order) for level in range(degree + 1) for order in range(-level, level + 1)]
    levels, orders = np.array(of).T
    x, y, z = directions.T.astype(np.float64)
    values = sph_harm_y(levels, abs(orders), np.arccos(z.clip(-1, 1))[:, None], np.arctan2(y, x)[:, None])
    return np.asarray(np.where(orders < 0, values.imag, values.real) * np.where(orders == 0, 1, np.sqrt(2)))


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


def turn_sh(sh: Float32[np.ndarray, "G H 3"], rotation: Float64[np.ndarray, "3 3"]) -> Float32[np.ndarray, "G H 3"]:
    """Rotate all coefficients alike, without the kernels of `turn`, which a confined process cannot cache."""
    matrix = np.eye(sh.shape[1])
    for degree in range(1, round(sh.shape[1] ** 0.5)):  # f'(d) = f(Rᵀ d)
        band = slice(degree**2, (degree + 1) ** 2)
        matrix[band, band] = sample_inverse(degree) @ harmonics(sample_directions(degree) @ rotation, degree)[:, band]
    return (sh.reshape(len(sh), -1) @ np.kron(matrix, np.eye(3)).T.astype(np.float32)).reshape(sh.shape)
