"""Laws of a rig's flutter: ends turn, faster than the spectrum, in a loop, by the wind's speed and the foliage."""

from dataclasses import replace

import numpy as np
import pytest
from jaxtyping import Complex64

from dynamictree.rig.flutter import fluttering
from dynamictree.rig.rig import Rig, rig_of
from dynamictree.spectrum import SparseVoxelSpectrum, Wind
from lab.dataset.sample import Sample, make_sample, voxel_spectrum


@pytest.fixture(scope="module")
def sample() -> Sample:
    return make_sample(3, "sapling")


@pytest.fixture(scope="module")
def spectrum(sample: Sample) -> SparseVoxelSpectrum:
    return replace(voxel_spectrum(sample)[1], wind=Wind(speed_m_s=8.0), foliage=1.0)


@pytest.fixture(scope="module")
def rig(sample: Sample, spectrum: SparseVoxelSpectrum) -> Rig:
    return rig_of(sample.mesh, spectrum)


def flutter_modes(rig: Rig, spectrum: SparseVoxelSpectrum, size: float) -> Complex64[np.ndarray, "B L 3"]:
    return fluttering(replace(rig, turns=0 * rig.turns), spectrum, size).turns


def test_only_ends_turn_and_only_above_the_spectrum(rig: Rig, spectrum: SparseVoxelSpectrum) -> None:
    modes = flutter_modes(rig, spectrum, 1.0)
    turning = np.abs(modes).max(axis=(1, 2)) > 0
    assert turning.any()
    assert not turning[rig.skeleton.above].any()
    assert not modes[:, : spectrum.num_frequencies].any()
    assert (modes.shape[1] - 1) / spectrum.period_s <= 8.0
    np.testing.assert_array_equal(modes, flutter_modes(rig, spectrum, 1.0))
    assert (modes != flutter_modes(rig, replace(spectrum, seed=spectrum.seed + 1), 1.0)).any()


def test_long_cards_and_ends_of_stems_turn_less_forks_and_one_surface_not_at_all(rig, spectrum) -> None:
    bones, modes = rig.skeleton, flutter_modes(rig, spectrum, 1.0)
    few = replace(rig, skeleton=replace(bones, reach_m=bones.reach_m * 99))
    assert 0 < np.abs(flutter_modes(few, spectrum, 1.0)).max() < 0.5 * np.abs(modes).max()
    bent = replace(rig, vertices=replace(rig.vertices, shares=np.full_like(rig.vertices.shares, 0.5)))
    np.testing.assert_allclose(flutter_modes(bent, spectrum, 1.0), 0.3 * modes, rtol=1e-5)
    ends = np.abs(modes).max(axis=(1, 2)) > 0
    forks = ends & (np.bincount(bones.above[ends], minlength=len(bones))[bones.above] > 1)
    feet = np.where(forks[:, None], (bones.foot_m + bones.reach_m)[bones.above], bones.foot_m)  # one surface that forks
    moved = flutter_modes(replace(rig, skeleton=replace(bones, foot_m=feet)), spectrum, 1.0)
    np.testing.assert_array_equal(moved, np.where(forks[:, None, None], 0, modes))
    whole = replace(rig, skeleton=replace(bones, in_surface=np.ones(len(bones), np.bool_)))
    assert not flutter_modes(whole, spectrum, 1.0).any()


@pytest.mark.parametrize(
    ("change", "size"),
    [({"wind": Wind(speed_m_s=1.0, gust=0.1)}, 1.0), ({"foliage": 0.0}, 1.0), ({}, 0.0)],
    ids=["light air", "bare", "off"],
)
def test_nothing_flutters_in_light_air_on_bare_trees_or_where_it_is_turned_off(
    rig: Rig, spectrum: SparseVoxelSpectrum, change: dict[str, object], size: float
) -> None:
    assert not flutter_modes(rig, replace(spectrum, **change), size).any()


def test_leaves_move_on_their_twigs_and_the_trunk_stands_as_before(rig, spectrum, sample: Sample) -> None:
    moving = fluttering(rig, spectrum, 1.0)
    places = sample.mesh.vertices
    for phase in (0.0, 0.37):
        own, more = (
            one.displacement(next(one.theta(np.array([phase]))), places, one.vertices) for one in (rig, moving)
        )
        far = np.linalg.norm(more - own, axis=1)
        assert 0 < far.max() < 0.03 * sample.mesh.height_m
        assert far[sample.part == 0].max() < 1e-6 * far.max()
    again = moving.displacement(next(moving.theta(np.array([1.37]))), places, moving.vertices)
    np.testing.assert_allclose(again, more, atol=1e-5 * sample.mesh.height_m)
