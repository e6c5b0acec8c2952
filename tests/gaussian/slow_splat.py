"""Readable twin of the renderer and its gradient: every Gaussian at every pixel, in double precision, by autograd."""

from dataclasses import dataclass
from math import factorial

import numpy as np
import torch

from dynamictree.gaussian.cloud import GaussianCloud
from dynamictree.gaussian.rasterize_kernel import MAX_ALPHA, MIN_ALPHA, NEAR_M, PIXEL_PX2, WIDEST
from dynamictree.render.camera import Camera

Tensor = torch.Tensor


@dataclass(frozen=True, kw_only=True)
class Leaves:
    """What is optimised."""

    means: Tensor
    quaternions: Tensor
    log_scales: Tensor
    logit_opacity: Tensor
    sh: Tensor


def leaves_of(cloud: GaussianCloud) -> Leaves:
    """A cloud in double precision."""
    means, quaternions, scales, opacity, sh = (
        torch.tensor(np.asarray(values, np.float64))
        for values in (cloud.means, cloud.quaternions, cloud.scales, cloud.opacity, cloud.sh)
    )
    return Leaves(means=means, quaternions=quaternions, log_scales=scales.log(), logit_opacity=opacity.logit(), sh=sh)


def harmonics(d: Tensor, degree: int) -> Tensor:
    """By Legendre's recursion in Cartesian form, not by the table that the kernels have."""
    x, y, z = d.unbind(-1)
    rows = []
    for level in range(degree + 1):
        for m in range(-level, level + 1):
            size = abs(m)
            # Π: derivative of the Legendre polynomial, by its coefficients
            legendre = np.polynomial.legendre.Legendre.basis(level).convert(kind=np.polynomial.Polynomial)
            coefficients = (legendre.deriv(size) if size else legendre).coef
            along = sum(float(c) * z**power for power, c in enumerate(coefficients))
            around = torch.complex(x, y) ** size if size else torch.ones_like(torch.complex(x, y))
            norm = np.sqrt((2 * level + 1) / (4 * np.pi) * factorial(level - size) / factorial(level + size))
            norm *= (-1) ** size * np.sqrt(2) if m else 1
            rows.append(norm * along * (around.imag if m < 0 else around.real))
    return torch.stack(rows, dim=-1)


def draw_slowly(leaves: Leaves, camera: Camera, *, width: int, height: int, min_alpha: float = MIN_ALPHA) -> Tensor:
    """Colour and depth, both times alpha, and what is left of the light [H, W, 5]; of all, with `min_alpha=0`."""
    turn = torch.tensor(camera.world_to_camera)
    k = torch.tensor(camera.intrinsics_px(width, height))
    offset = leaves.means - torch.tensor(camera.position_m)
    in_camera = offset @ turn.T
    x, y, z = in_camera.unbind(-1)
    w, i, j, q = torch.nn.functional.normalize(leaves.quaternions, dim=-1).unbind(-1)
    rows = [
        [1 - 2 * (j * j + q * q), 2 * (i * j - w * q), 2 * (i * q + w * j)],
        [2 * (i * j + w * q), 1 - 2 * (i * i + q * q), 2 * (j * q - w * i)],
        [2 * (i * q - w * j), 2 * (j * q + w * i), 1 - 2 * (i * i + j * j)],
    ]
    rotation = torch.stack([torch.stack(row, dim=-1) for row in rows], dim=-2)
    half = turn @ rotation * leaves.log_scales.exp()[:, None, :]
    focal = k[0, 0]
    limits = [WIDEST * 0.5 * side / focal for side in (width, height)]
    slopes = [torch.clamp(v / z, -float(limit), float(limit)) for v, limit in zip((x, y), limits, strict=True)]
    zero, one = torch.zeros_like(z), torch.ones_like(z)
    jacobian = (
        torch.stack(
            [torch.stack([one, zero, -slopes[0]], dim=-1), torch.stack([zero, one, -slopes[1]], dim=-1)], dim=-2
        )
        * (focal / z)[:, None, None]
    )
    in_picture = jacobian @ half
    sharp = in_picture @ in_picture.transpose(1, 2)
    blurred = sharp + PIXEL_PX2 * torch.eye(2, dtype=torch.float64)
    opacity = leaves.logit_opacity.sigmoid() * (torch.linalg.det(sharp) / torch.linalg.det(blurred)).sqrt()
    conics = torch.linalg.inv(blurred)
    centres = (in_camera @ k.T / z[:, None])[:, :2]
    degree = round(leaves.sh.shape[1] ** 0.5) - 1
    values = harmonics(torch.nn.functional.normalize(offset, dim=-1), degree)
    colors = (0.5 + torch.einsum("gh,ghc->gc", values, leaves.sh)).clamp(min=0)
    columns, lines = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    pixels = torch.tensor(np.stack([columns, lines], axis=-1))
    light = torch.ones((height, width), dtype=torch.float64)
    total = torch.zeros((height, width, 4), dtype=torch.float64)
    for g in torch.argsort(z).tolist():
        if z[g] < NEAR_M:
            continue
        away = pixels - centres[g]
        alpha = opacity[g] * torch.exp(-0.5 * torch.einsum("hwi,ij,hwj->hw", away, conics[g], away))
        alpha = torch.where(alpha < min_alpha, 0.0, alpha).clamp(max=MAX_ALPHA)
        visible = (alpha * light)[..., None]
        total = total + visible * torch.cat([colors[g], z[g : g + 1]])
        light = light * (1 - alpha)
    return torch.cat([total, light[..., None]], dim=-1)
