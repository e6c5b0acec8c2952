from dataclasses import replace

import numpy as np
import pytest

from dynamictree.dataset.loader import (
    NO_FAULTS,
    Augmentation,
    Faults,
    augmented,
    placing,
    time_shifted,
    turned_wind,
    with_faults,
)
from dynamictree.dataset.sample import make_sample
from dynamictree.dataset.shards import store
from dynamictree.errors import InputError
from dynamictree.mesh import validate_mesh
from dynamictree.spectrum import Wind, to_motion

NOTHING = Augmentation(turn=False, mirror=False, scale=0.0, time_shift=False, fault_rate=0.0)


@pytest.fixture(scope="module")
def stored():
    return store(make_sample(7, "sapling"), resolutions=(64,))


def test_without_augmentation_a_tree_is_as_it_was_stored(stored, rng):
    example = augmented(stored, rng, augmentation=NOTHING, resolution=64)
    np.testing.assert_array_equal(example.voxels.grid.coords, stored.voxels(64).grid.coords)
    np.testing.assert_array_equal(example.spectrum.coefficients, stored.spectrum(64).coefficients)
    assert example.wind == stored.wind


def test_a_turned_tree_leans_along_its_turned_wind(stored):
    for seed in range(4):
        rng = np.random.default_rng(seed)
        example = augmented(stored, rng, augmentation=replace(NOTHING, turn=True, mirror=True), resolution=64)
        lean = example.spectrum.coefficients[:, 0].real.mean(axis=0)
        heading = np.deg2rad(example.wind.direction_deg)
        along = lean[0] * np.cos(heading) + lean[1] * np.sin(heading)
        assert along > 0.95 * np.linalg.norm(lean[:2])


def test_turning_keeps_amplitudes(stored, rng):
    before = np.abs(stored.spectrum(64).coefficients).mean(axis=(0, 2))
    example = augmented(stored, rng, augmentation=replace(NOTHING, turn=True), resolution=64)
    np.testing.assert_allclose(np.abs(example.spectrum.coefficients).mean(axis=(0, 2)), before, rtol=0.2)


def test_a_quarter_turn_is_exact(stored):
    matrix = placing(np.pi / 2, mirrored=False, scale=1.0)
    np.testing.assert_allclose(matrix @ [1, 2, 3], [-2, 1, 3], atol=1e-6)
    assert turned_wind(Wind(direction_deg=30.0), np.pi / 2, mirrored=False).direction_deg == pytest.approx(120)
    assert turned_wind(Wind(direction_deg=30.0), 0.0, mirrored=True).direction_deg == pytest.approx(330)
    assert np.linalg.det(placing(1.0, mirrored=True, scale=1.1)) == pytest.approx(-(1.1**3), rel=1e-5)


def test_a_scaled_tree_moves_as_much_farther(stored):
    rng = np.random.default_rng(3)
    example = augmented(stored, rng, augmentation=replace(NOTHING, scale=0.3), resolution=64)
    factor = example.voxels.grid.voxel_size_m / stored.voxels(64).grid.voxel_size_m
    assert abs(factor - 1) > 0.01
    amplitude = np.abs(example.spectrum.coefficients).max() / np.abs(stored.spectrum(64).coefficients).max()
    assert amplitude == pytest.approx(factor, rel=1e-3)


@pytest.mark.parametrize("frames", [0, 1, 37])
def test_a_time_shift_by_whole_frames_rolls_the_motion(stored, frames):
    spectrum = stored.spectrum(64)
    shifted = to_motion(time_shifted(spectrum, float(frames)).coefficients)
    np.testing.assert_allclose(shifted, np.roll(to_motion(spectrum.coefficients), -frames, axis=0), atol=1e-6)


def test_time_shifts_add_up(stored):
    spectrum = stored.spectrum(64)
    twice = time_shifted(time_shifted(spectrum, 3.3), 4.9).coefficients
    np.testing.assert_allclose(twice, time_shifted(spectrum, 8.2).coefficients, atol=1e-6)


def test_a_shifted_motion_from_its_first_frame_begins_at_zero(stored):
    spectrum = replace(stored.spectrum(64), rest="first-frame")
    motion = to_motion(time_shifted(spectrum, 12.0).coefficients)
    np.testing.assert_allclose(motion[0], 0, atol=1e-6)
    whole = to_motion(spectrum.coefficients)
    np.testing.assert_allclose(motion, np.roll(whole, -12, axis=0) - whole[12], atol=1e-6)


def test_a_spectrum_with_the_bin_half_way_cannot_be_shifted(stored):
    spectrum = stored.spectrum(64)
    with pytest.raises(InputError, match="bin T / 2"):
        time_shifted(replace(spectrum, num_frames=30), 1.0)


@pytest.mark.parametrize(
    "faults",
    [
        replace(NO_FAULTS, missing_pieces=4, missing_radius=0.3),
        replace(NO_FAULTS, noise=0.02),
        replace(NO_FAULTS, decimation=0.9),
        replace(NO_FAULTS, floaters=20),
    ],
    ids=["missing pieces", "noise", "decimation", "floaters"],
)
def test_every_fault_changes_the_mesh_and_leaves_it_usable(spreading, faults):
    spoiled = validate_mesh(with_faults(spreading.mesh, np.random.default_rng(4), faults))
    same_faces = spoiled.num_faces == spreading.mesh.num_faces
    assert not (same_faces and np.array_equal(spoiled.vertices, spreading.mesh.vertices))
    assert spoiled.height_m == pytest.approx(spreading.mesh.height_m, rel=0.2)


def test_no_faults_leave_the_mesh_alone(spreading, rng):
    same = with_faults(spreading.mesh, rng, NO_FAULTS)
    np.testing.assert_array_equal(same.vertices, spreading.mesh.vertices)
    np.testing.assert_array_equal(same.faces, spreading.mesh.faces)


def test_faults_do_not_change_how_the_tree_moves(stored):
    rng = np.random.default_rng(5)
    example = augmented(stored, rng, augmentation=replace(NOTHING, fault_rate=1.0, faults=Faults()), resolution=64)
    assert len(example.voxels.grid) != len(stored.voxels(64).grid)
    before, after = (np.abs(one.coefficients).mean() for one in (stored.spectrum(64), example.spectrum))
    assert after == pytest.approx(before, rel=0.25)
