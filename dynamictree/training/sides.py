"""The eight sides from which a voxel grid can be seen exactly: quarter turns about the vertical, and their mirrors."""

import torch
from jaxtyping import Float32
from torch import Tensor

SIDES: tuple[tuple[tuple[int, int, int], tuple[int, int, int]], ...] = tuple(
    (axes, (east, north, 1)) for axes in ((0, 1, 2), (1, 0, 2)) for east in (1, -1) for north in (1, -1)
)
"""Axes and signs of the turns by 90° about the vertical, and of their mirrors."""


def is_mirror(axes: tuple[int, int, int], signs: tuple[int, int, int]) -> bool:
    """A turn keeps left and right apart, a mirror exchanges them."""
    odd = axes != (0, 1, 2)
    return (signs[0] * signs[1] < 0) != odd


def turn_wind(
    wind: Float32[Tensor, "B 4"], axes: tuple[int, int, int], signs: tuple[int, int, int]
) -> Float32[Tensor, "B 4"]:
    """The wind, turned with its tree."""
    heading = wind[:, 2:][:, list(axes[:2])] * torch.tensor(signs[:2], dtype=wind.dtype)
    return torch.cat([wind[:, :2], heading], dim=1)


def crosswind_sign(axes: tuple[int, int, int], signs: tuple[int, int, int]) -> Float32[Tensor, "3"]:
    """By what a vector in the wind's frame is multiplied: a mirror exchanges the sides, a turn does not."""
    return torch.tensor([1.0, -1.0 if is_mirror(axes, signs) else 1.0, 1.0])
