"""Occupied voxels and their neighbour pairs: built once per grid, shared by all layers and sampling steps.

The rows of a batch are its samples one after another. A level holds, for 13 of the 26 directions, the pairs of rows
(a, b) with coords[b] = coords[a] + offset; the other 13 directions are the same pairs read backwards.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import accumulate

import torch
from jaxtyping import Int64
from torch import Tensor

from dynamictree.voxel.graph import CENTRE, OFFSETS, neighbour_pairs

Pair = tuple[Int64[Tensor, " _"], Int64[Tensor, " _"]]


@dataclass(frozen=True, kw_only=True, eq=False)
class SparseLevel:
    """The occupied voxels of one or several grids of one resolution."""

    coords: Int64[Tensor, "V 3"]
    sizes: tuple[int, ...]  # voxels of each sample
    pairs: tuple[Pair, ...]  # one for each of OFFSETS[:CENTRE]

    def __len__(self) -> int:
        return len(self.coords)

    @property
    def sample_slices(self) -> list[slice]:
        """The rows of each sample."""
        ends = torch.tensor(self.sizes).cumsum(0).tolist()
        return [slice(end - size, end) for size, end in zip(self.sizes, ends, strict=True)]

    @property
    def sample_of_row(self) -> Int64[Tensor, " V"]:
        """Index of the sample that each row belongs to."""
        sizes = torch.tensor(self.sizes, device=self.coords.device)
        rows = torch.arange(len(sizes), device=self.coords.device)
        return torch.repeat_interleave(rows, sizes, output_size=sum(self.sizes))


@dataclass(frozen=True, kw_only=True, eq=False)
class Pyramid:
    """A grid and its coarser ones, with voxels twice as large each: level l + 1 has exactly the parents of level l."""

    levels: tuple[SparseLevel, ...]
    parents: tuple[Int64[Tensor, " _"], ...]  # row in level l + 1 of each voxel of level l

    def rows_above(self, top: int, bottom: int = 0) -> Int64[Tensor, " _"]:
        """Row in level `top` of each voxel of level `bottom`."""
        rows = torch.arange(len(self.levels[bottom]), device=self.levels[bottom].coords.device)
        for parents in self.parents[bottom:top]:
            rows = parents[rows]
        return rows


def sparse_level(coords: Int64[Tensor, "V 3"]) -> SparseLevel:
    """Build the level of one sample's voxels, which may be in any order."""
    pairs = tuple((torch.from_numpy(a), torch.from_numpy(b)) for a, b in neighbour_pairs(coords.numpy()))
    return SparseLevel(coords=coords, sizes=(len(coords),), pairs=pairs)


def pyramid(coords: Int64[Tensor, "V 3"], num_levels: int) -> Pyramid:
    """Build one sample's grid and `num_levels` - 1 coarser ones."""
    levels = [sparse_level(coords)]
    parents = []
    for _ in range(num_levels - 1):
        coarse, parent = torch.unique(levels[-1].coords // 2, dim=0, return_inverse=True)
        parents.append(parent)
        levels.append(sparse_level(coarse))
    return Pyramid(levels=tuple(levels), parents=tuple(parents))


def batch_levels(levels: Sequence[SparseLevel]) -> SparseLevel:
    """Join several samples to one batch; no pair crosses from one to another."""
    starts = _starts([len(level) for level in levels])
    pairs = tuple(
        (
            torch.cat([level.pairs[tap][0] + start for level, start in zip(levels, starts, strict=True)]),
            torch.cat([level.pairs[tap][1] + start for level, start in zip(levels, starts, strict=True)]),
        )
        for tap in range(CENTRE)
    )
    sizes = tuple(size for level in levels for size in level.sizes)
    return SparseLevel(coords=torch.cat([level.coords for level in levels]), sizes=sizes, pairs=pairs)


def batch_pyramids(pyramids: Sequence[Pyramid]) -> Pyramid:
    """Join several samples' pyramids of equal depth."""
    levels = tuple(batch_levels(same) for same in zip(*(one.levels for one in pyramids), strict=True))
    parents = []
    for depth in range(len(levels) - 1):
        starts = _starts([len(one.levels[depth + 1]) for one in pyramids])
        parents.append(torch.cat([one.parents[depth] + start for one, start in zip(pyramids, starts, strict=True)]))
    return Pyramid(levels=levels, parents=tuple(parents))


def turn_level(level: SparseLevel, axes: tuple[int, int, int], signs: tuple[int, int, int]) -> SparseLevel:
    """Permute and flip axes: new axis i is old axis `axes[i]` times `signs[i]`. Rows keep their order."""
    pairs: list[Pair | None] = [None] * CENTRE
    for (first, second), offset in zip(level.pairs, OFFSETS, strict=False):
        turned = tuple(sign * offset[axis] for axis, sign in zip(axes, signs, strict=True))
        tap = OFFSETS.index((turned[0], turned[1], turned[2]))
        pairs[min(tap, 26 - tap)] = (first, second) if tap < CENTRE else (second, first)
    coords = torch.stack([sign * level.coords[:, axis] for axis, sign in zip(axes, signs, strict=True)], dim=1)
    return SparseLevel(coords=coords, sizes=level.sizes, pairs=tuple(pair for pair in pairs if pair is not None))


def turn_pyramid(grids: Pyramid, axes: tuple[int, int, int], signs: tuple[int, int, int]) -> Pyramid:
    """Apply `turn_level` to every level: an exact turn by 90° or mirror, without building the pairs again."""
    return Pyramid(levels=tuple(turn_level(level, axes, signs) for level in grids.levels), parents=grids.parents)


def _starts(sizes: Sequence[int]) -> list[int]:
    return list(accumulate(sizes[:-1], initial=0))
