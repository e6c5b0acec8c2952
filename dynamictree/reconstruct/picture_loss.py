"""Loss between a picture and a photo, L1 and D-SSIM, with its gradient. Kerbl et al. 2023, eq. 7."""

from typing import NamedTuple, no_type_check

import numpy as np
from jaxtyping import Float32

from dynamictree.parallel import compiled_fused, in_bands

SSIM_SHARE = 0.2  # λ of Kerbl et al.
_RADIUS, _SIGMA = 5, 1.5  # Wang et al. 2004
_C1, _C2 = np.float32(0.01**2), np.float32(0.03**2)
_GAUSSIAN = np.exp(-0.5 * (np.arange(-_RADIUS, _RADIUS + 1) / _SIGMA) ** 2)
WINDOW = (_GAUSSIAN / _GAUSSIAN.sum()).astype(np.float32)
"""SSIM's separable Gaussian window along one axis."""
_W = tuple(WINDOW)
_TAPS = 2 * _RADIUS + 1
_ONE, _TWO = np.float32(1), np.float32(2)


class Loss(NamedTuple):
    """Loss and its gradient by the picture."""

    value: float
    gradient: Float32[np.ndarray, "3 H W"]


def picture_loss(
    picture: Float32[np.ndarray, "3 H W"], photo: Float32[np.ndarray, "3 H W"], *, ssim_share: float = SSIM_SHARE
) -> Loss:
    """Compute (1 − λ) L1 + λ (1 − SSIM), averaged over pixels and channels in [0, 1], and its gradient.

    SSIM is that of Wang et al. 2004, with a Gaussian window of 11 pixels and zero padding.
    """
    rows = picture.shape[0] * picture.shape[1]
    flat, flat_photo = picture.reshape(rows, -1), photo.reshape(rows, -1)
    maps = np.empty((4, *picture.shape), np.float32)
    in_bands(_products, rows, flat, flat_photo, maps.reshape(4, rows, -1))
    blurred = blur(maps.reshape(-1, *picture.shape[1:])).reshape(4, rows, -1)
    back = maps[:3].reshape(3, rows, -1)  # buffers reused for the derivatives
    similarity, distance = np.empty(rows, np.float64), np.empty(rows, np.float64)
    in_bands(_compare, rows, blurred, np.float32(ssim_share / picture.size), back, similarity)
    by_maps = blur(back.reshape(-1, *picture.shape[1:])).reshape(3, rows, -1)
    gradient = np.empty_like(picture)
    share = np.float32((1 - ssim_share) / picture.size)
    in_bands(_combine, rows, flat, flat_photo, by_maps, share, gradient.reshape(rows, -1), distance)
    mean_distance, mean_similarity = float(distance.sum()) / picture.size, float(similarity.sum()) / picture.size
    return Loss((1 - ssim_share) * mean_distance + ssim_share * (1 - mean_similarity), gradient)


def psnr(picture: Float32[np.ndarray, "*shape"], photo: Float32[np.ndarray, "*shape"]) -> float:
    """Compute the peak signal-to-noise ratio of values in [0, 1] [dB]."""
    return -10 * float(np.log10(max(np.square(picture - photo, dtype=np.float64).mean(), 1e-12)))


def ssim(picture: Float32[np.ndarray, "3 H W"], photo: Float32[np.ndarray, "3 H W"]) -> float:
    """Compute the structural similarity, averaged over pixels and channels; 1 for equal pictures."""
    return 1 - picture_loss(picture, photo, ssim_share=1.0).value


def blur(planes: Float32[np.ndarray, "P H W"]) -> Float32[np.ndarray, "P H W"]:
    """Convolve each plane with SSIM's window, with zero padding; the operator is self-adjoint."""
    result = np.empty_like(planes)
    in_bands(_blur_rows, planes.shape[0] * planes.shape[1], planes, result)
    return result


@compiled_fused
@no_type_check
def _blur_rows(first, end, planes, result):
    _, height, width = planes.shape
    down = np.zeros(width + 2 * _RADIUS, np.float32)  # zero padding on both sides
    rows = np.empty((_TAPS, width), np.float32)
    for place in range(first, end):
        plane, row = place // height, place % height
        top, bottom = max(row - _RADIUS, 0), min(row + _RADIUS + 1, height)
        if bottom - top == _TAPS:
            _blur_down(planes[plane, top:bottom], down)
        else:
            rows[:] = 0
            rows[top - row + _RADIUS : bottom - row + _RADIUS] = planes[plane, top:bottom]
            _blur_down(rows, down)
        _blur_along(down, result[plane, row])


@compiled_fused
@no_type_check
def _blur_down(a, out):
    """Convolve eleven rows vertically, and write behind the padding; terms are spelled out so that LLVM vectorizes."""
    for j in range(np.uint32(a.shape[1])):
        far = _W[0] * (a[0, j] + a[10, j]) + _W[1] * (a[1, j] + a[9, j]) + _W[2] * (a[2, j] + a[8, j])
        near = _W[3] * (a[3, j] + a[7, j]) + _W[4] * (a[4, j] + a[6, j]) + _W[5] * a[5, j]
        out[j + np.uint32(_RADIUS)] = far + near


@compiled_fused
@no_type_check
def _blur_along(a, out):
    """Convolve a padded row horizontally."""
    b, c, d, e, f, g, h, i, k, last = a[1:], a[2:], a[3:], a[4:], a[5:], a[6:], a[7:], a[8:], a[9:], a[10:]
    for j in range(np.uint32(len(out))):
        far = _W[0] * (a[j] + last[j]) + _W[1] * (b[j] + k[j]) + _W[2] * (c[j] + i[j])
        out[j] = far + _W[3] * (d[j] + h[j]) + _W[4] * (e[j] + g[j]) + _W[5] * f[j]


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
    """Combine the gradients through the SSIM maps with that of L1; write the sum of absolute differences."""
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
    """Compute SSIM from blurred maps, with its derivatives by the mean, the sum of squares and the product."""
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
