"""Our trees beside two that Blender's Sapling add-on baked: the same in kind, by the same measures.

Sapling's wind is 1 on its own scale; ours is 5 m/s. The figures stand in docs/decisions/dataset.md.
"""

from pathlib import Path

import numpy as np
import pytest

from dynamictree.spectrum import Wind
from lab.dataset.sample import make_sample
from tests.lab.dataset.stems import StemTable, bending, first_bins_share, tables_of

OURS = ("round-broadleaf", "maple", "columnar", "conical-conifer", "pine", "birch", "bare-winter", "sapling")


def sapling_table(path: Path) -> StemTable:
    with np.load(path, allow_pickle=False) as baked:
        names, parent, mats = baked["bone_names"], baked["bone_parent"], baked["bone_mats"]
        head, tail, rest, part, comp = (baked[name] for name in ("bone_head", "bone_tail", "rest", "part", "comp"))
        displacement = baked["vertices"] - rest
    stem = np.array([int(name[4:7]) for name in names])
    step = np.array([int(name[8:11]) for name in names])
    first, last = np.lexsort((step, stem)), np.lexsort((-step, stem))
    begins = np.searchsorted(np.sort(stem), np.unique(stem))
    first, last = first[begins], last[begins]
    above = np.where(parent[first] < 0, first, parent[first])
    frequency, amplitude = bending(mats[:, above, :3, :3], mats[:, last, :3, :3])
    wood = [rest[(part == 0) & (comp == row)] for row in range(len(first))]
    near = [np.sort(np.linalg.norm(points - head[bone], axis=1))[:3] for points, bone in zip(wood, first, strict=True)]
    return StemTable(
        level=(first > 0).astype(np.int8),
        length_m=np.bincount(stem, np.linalg.norm(tail - head, axis=1)).astype(np.float32),
        radius_m=np.array([ring.mean() for ring in near], np.float32),
        frequency_hz=frequency,
        amplitude_rad=amplitude,
        first_bins_share=first_bins_share(displacement),
    )


@pytest.fixture(scope="module")
def theirs(samples) -> list[StemTable]:
    return [sapling_table(path) for path in sorted((samples / "sapling").glob("*.npz"))]


@pytest.fixture(scope="module")
def ours(theirs: list[StemTable]) -> list[StemTable]:
    """None where there are none to compare with."""
    return [tables_of(make_sample(seed, name, wind=Wind(speed_m_s=5.0))) for seed, name in enumerate(OURS)]


def column(tables, name, level):
    return np.concatenate([getattr(table, name)[table.level == level] for table in tables])


def slope(tables, name):
    """Exponent of a quantity in stem length, over all moving stems."""
    length = np.concatenate([table.length_m for table in tables])
    value = np.concatenate([getattr(table, name) for table in tables])
    return np.polyfit(np.log(length[value > 0]), np.log(value[value > 0]), 1)[0]


def test_frequency_goes_with_length_as_saplings_does(ours, theirs):
    assert slope(theirs, "frequency_hz") == pytest.approx(-0.5, abs=0.15)
    assert slope(ours, "frequency_hz") == pytest.approx(-0.5, abs=0.15)
    for level in (0, 1):
        constants = [
            np.median(column(tables, "frequency_hz", level) * np.sqrt(column(tables, "length_m", level)))
            for tables in (ours, theirs)
        ]
        assert constants[0] == pytest.approx(constants[1], rel=0.35)


def test_stems_bend_as_far_as_saplings_do(ours, theirs):
    for level in (0, 1):
        mine, other = (np.median(column(tables, "amplitude_rad", level)) for tables in (ours, theirs))
        assert 1 / 4 < mine / other < 4


def test_slenderer_stems_bend_farther_in_both(ours, theirs):
    for tables in (ours, theirs):
        slenderness = np.concatenate([table.length_m / table.radius_m for table in tables])
        bend = np.concatenate([table.amplitude_rad for table in tables])
        assert np.corrcoef(np.log(slenderness), np.log(np.maximum(bend, 1e-6)))[0, 1] > 0.2


def test_branches_are_as_long_and_thick_for_their_tree_as_saplings(ours, theirs):
    for name, factor in (("length_m", 2), ("radius_m", 3)):
        shares = []
        for tables in (ours, theirs):
            by_tree = [
                np.median(getattr(table, name)[table.level == 1]) / getattr(table, name)[table.level == 0].max()
                for table in tables
            ]
            shares.append(np.median(by_tree))
        assert 1 / factor < shares[0] / shares[1] < factor


def test_sixteen_frequencies_hold_the_motion_of_both(ours, theirs):
    assert min(table.first_bins_share for table in theirs) > 0.99
    assert min(table.first_bins_share for table in ours) > 0.99
