"""How far a picture is from a photo: L1 and D-SSIM, and their gradient. Kerbl et al. 2023, eq. 7."""

from typing import NamedTuple, no_type_check

import numpy as np
from jaxtyping import Float32

from dynamictree.parallel import compiled_fused, in_bands

SSIM_SHARE = 0.2  # λ of Kerbl et al.
_RADIUS, _SIGMA = 5, 1.5  # Wang et al. 2004
_C1, _C2 = np.float32(0.01**2), np.float32(0.03**2)
_BELL = np.exp(-0.5 * (np.arange(-_RADIUS, _RADIUS + 1) / _SIGMA) ** 2)
WINDOW = (_BELL / _BELL.sum()).astype(np.float32)
"""Along each axis."""
_TAPS = 2 * _RADIUS + 1
_ONE, _TWO = np.float32(1), np.float32(2)


class Loss(NamedTuple):
    """A loss and its gradient by the picture."""

    value: float
    gradient: Float32[np.ndarray, "3 H W"]


def picture_loss(
    picture: Float32[np.ndarray, "3 H W"], photo: Float32[np.ndarray, "3 H W"], *, ssim_share: float = SSIM_SHARE
) -> Loss:
    """(1 − λ) L1 + λ (1 − SSIM), means over pixels and channels in [0, 1].

    SSIM is Wang et al.'s (2004), in a Gaussian window of 11 pixels, zero beyond the edge.
    """
    rows = picture.shape[0] * picture.shape[1]
    flat, flat_photo = picture.reshape(rows, -1), photo.reshape(rows, -1)
    maps = np.empty((4, *picture.shape), np.float32)
    in_bands(_products, rows, flat, flat_photo, maps.reshape(4, rows, -1))
    blurred = blur(maps.reshape(-1, *picture.shape[1:])).reshape(4, rows, -1)
    back = maps[:3].reshape(3, rows, -1)  # written over
    similarity, distance = np.empty(rows, np.float64), np.empty(rows, np.float64)
    in_bands(_compare, rows, blurred, np.float32(ssim_share / picture.size), back, similarity)
    by_maps = blur(back.reshape(-1, *picture.shape[1:])).reshape(3, rows, -1)
    gradient = np.empty_like(picture)
    share = np.float32((1 - ssim_share) / picture.size)
    in_bands(_combine, rows, flat, flat_photo, by_maps, share, gradient.reshape(rows, -1), distance)
    mean_distance, mean_similarity = float(distance.sum()) / picture.size, float(similarity.sum()) / picture.size
    return Loss((1 - ssim_share) * mean_distance + ssim_share * (1 - mean_similarity), gradient)


def psnr(picture: Float32[np.ndarray, "*shape"], photo: Float32[np.ndarray, "*shape"]) -> float:
    """Peak signal to noise of values in [0, 1] [dB]."""
    return -10 * float(np.log10(max(np.square(picture - photo, dtype=np.float64).mean(), 1e-12)))


def ssim(picture: Float32[np.ndarray, "3 H W"], photo: Float32[np.ndarray, "3 H W"]) -> float:
    """Structural similarity, the mean over pixels and channels; 1 for the same picture."""
    return 1 - picture_loss(picture, photo, ssim_share=1.0).value


def blur(planes: Float32[np.ndarray, "P H W"]) -> Float32[np.ndarray, "P H W"]:
    """Each plane blurred by SSIM's window, zero beyond its edges; its own adjoint."""
    result = np.empty_like(planes)
    in_bands(_blur_rows, planes.shape[0] * planes.shape[1], planes, WINDOW, result)
    return result


@compiled_fused
@no_type_check
def _blur_rows(first, end, planes, window, result):
    _, height, width = planes.shape
    row_sum = np.zeros(width + _TAPS, np.float32)  # with a margin of zeros on both sides
    for place in range(first, end):
        plane, row = place // height, place % height
        row_sum[:] = 0
        for k in range(max(0, _RADIUS - row), min(_TAPS, height + _RADIUS - row)):
            weight, source = window[k], planes[plane, row + k - _RADIUS]
            for j in range(np.uint32(width)):
                row_sum[j + np.uint32(_RADIUS)] += weight * source[j]
        target = result[plane, row]
        target[:] = 0
        for k in range(np.uint32(_TAPS)):
            weight = window[k]
            for j in range(np.uint32(width)):
                target[j] += weight * row_sum[j + k]


@compiled_fused
@no_type_check
def _products(first, end, picture, photo, maps):
    for row in range(first, end):
        for j in range(np.uint32(picture.shape[1])):
            x, y = picture[row, j], photo[row, j]
            maps[0, row, j], maps[1, row, j], maps[2, row, j], maps[3, row, j] = x, y, x * x + y * y, x * y


@compiled_fused
@no_type_check
def _combine(first, end, picture, photo, by_maps, share, gradient, distance):
    """Chain rule through the maps, and the gradient of L1."""
    for row in range(first, end):
        total = np.float32(0)
        for j in range(np.uint32(picture.shape[1])):
            x, y = picture[row, j], photo[row, j]
            through = by_maps[0, row, j] + _TWO * x * by_maps[1, row, j] + y * by_maps[2, row, j]
            gradient[row, j] = (share if x > y else -share) - through
            total += abs(x - y)
        distance[row] = total


@compiled_fused
@no_type_check
def _compare(first, end, blurred, share, back, values):
    """SSIM of blurred maps, and its derivatives by the mean, the sum of squares and the product."""
    for row in range(first, end):
        total = 0.0
        for j in range(blurred.shape[2]):
            x, y, squares, product = blurred[0, row, j], blurred[1, row, j], blurred[2, row, j], blurred[3, row, j]
            a1, a2 = _TWO * x * y + _C1, _TWO * (product - x * y) + _C2
            b1, b2 = x * x + y * y + _C1, squares - x * x - y * y + _C2
            per = _ONE / (b1 * b2)
            similar = a1 * a2 * per
            by_product, by_squares = _TWO * a1 * per, -similar / b2
            total += similar
            back[0, row, j] = share * (
                _TWO * y * a2 * per - _TWO * x * similar / b1 - y * by_product - _TWO * x * by_squares
            )
            back[1, row, j], back[2, row, j] = share * by_squares, share * by_product
        values[row] = total
