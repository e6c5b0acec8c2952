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
    maps = np.stack([picture, photo, picture * picture + photo * photo, picture * photo])
    x, y, squares, product = blur(maps.reshape(-1, *picture.shape[1:])).reshape(maps.shape)
    both, each = x * y, x * x + y * y
    a1, a2 = 2 * both + _C1, 2 * (product - both) + _C2
    b1, b2 = each + _C1, squares - each + _C2
    per = 1 / (b1 * b2)
    similar = a1 * a2 * per
    # derivatives by the blurred maps: mean, sum of squares and product
    by_product, by_squares = 2 * a1 * per, -similar / b2
    by_mean = 2 * y * a2 * per - 2 * x * similar / b1 - y * by_product - 2 * x * by_squares
    back = np.stack([by_mean, by_squares, by_product])
    by_mean, by_squares, by_product = blur(back.reshape(-1, *picture.shape[1:])).reshape(back.shape)
    difference = picture - photo
    of_distance, of_ssim = np.float32((1 - ssim_share) / picture.size), np.float32(ssim_share / picture.size)
    through = by_mean + 2 * picture * by_squares + photo * by_product
    gradient = np.where(difference > 0, of_distance, -of_distance) - of_ssim * through
    distance, similarity = (float(part.mean(dtype=np.float64)) for part in (np.abs(difference), similar))
    return Loss((1 - ssim_share) * distance + ssim_share * (1 - similarity), gradient)


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
