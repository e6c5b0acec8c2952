"""What a poke may reach."""

from dataclasses import replace

import numpy as np
import pytest

from dynamictree.errors import InputError
from dynamictree.modal.bones import WAY_FLOOR
from dynamictree.modal.force import Impulse, contact_at_voxel, generalised_force
from dynamictree.modal.locality import branching, default_falloff_m, poke_weights, unlikeness
from dynamictree.modal.step import State, exact_step, run
from dynamictree.modal.system import displacement, modal_system
from lab.dataset.sample import make_sample, voxel_spectrum
from tests.modal.trees import fork


@pytest.fixture(scope="module")
def forked():
    spectrum, parts = fork()
    system = modal_system(spectrum)
    return system, branching(system), parts


def test_what_the_poked_branch_carries_rides_with_it(forked):
    _, tree, parts = forked
    weights = poke_weights(tree, int(parts["right"][5]), 0.5)
    np.testing.assert_allclose(weights[parts["right"][5:]], 1, atol=0.02)


def test_ancestors_move_less_the_nearer_to_the_root(forked):
    _, tree, parts = forked
    weights = poke_weights(tree, int(parts["right"][3]), 0.5)
    down = weights[np.concatenate([parts["stem"], parts["right"][:4]])]
    assert (np.diff(down) >= -1e-6).all()
    assert down[0] < 0.01
    assert 0.3 < weights[parts["stem"][-1]] < 1


def test_other_branches_barely_move(forked):
    _, tree, parts = forked
    weights = poke_weights(tree, int(parts["right"][10]), 0.5)
    fork_weight = weights[parts["stem"][-1]]
    assert weights[parts["left"]].max() <= fork_weight
    assert weights[parts["left"][5:]].max() < 0.01


def test_a_larger_falloff_reaches_further(forked):
    _, tree, parts = forked
    near, far = (poke_weights(tree, int(parts["right"][10]), falloff) for falloff in (0.3, 1.0))
    assert (far >= near).all()
    assert far.sum() > near.sum() + 1


def test_an_endless_falloff_is_the_whole_tree(forked):
    _, tree, parts = forked
    np.testing.assert_allclose(poke_weights(tree, int(parts["right"][10]), 1e6), 1, atol=1e-6)


def test_voxels_of_one_stem_are_no_strangers_and_those_of_two_are(forked):
    system, _, parts = forked
    one = parts["right"].astype(np.int32)
    assert np.median(unlikeness(system, one[:-1], one[1:]) ** 3) < 0.05
    assert (unlikeness(system, one[-3:], parts["left"][-3:].astype(np.int32)) ** 3).min() > 0.25


def test_noise_where_hardly_anything_moves_makes_no_strangers(forked, rng):
    system, _, parts = forked
    foot = parts["stem"][:4].astype(np.int32)
    shapes = system.shapes.copy()
    shapes[foot] = 1e-3 * np.abs(shapes).max() * rng.normal(size=shapes[foot].shape)
    trembling = replace(system, shapes=shapes)
    assert unlikeness(trembling, foot[:-1], foot[1:]).min() > 0.5
    assert unlikeness(trembling, foot[:-1], foot[1:], floor=WAY_FLOOR).max() < 0.1


@pytest.mark.parametrize(("row", "falloff_m"), [(-1, 1.0), (150, 1.0), (0, 0.0), (0, float("nan"))])
def test_a_poke_that_is_none_is_refused(forked, row, falloff_m):
    with pytest.raises(InputError):
        poke_weights(forked[1], row, falloff_m)


def test_the_poked_branch_of_a_grown_tree_keeps_the_energy():
    """Kinetic energy outside of the poked stem, what it carries and its ancestors: at most 5 %, of all modes 90 %."""
    sample = make_sample(3, "round-broadleaf")
    _, spectrum = voxel_spectrum(sample, 64)
    system = modal_system(spectrum)
    stems = sample.skeleton
    # the longest branch of the first level, poked at its last ring
    first_level = np.unique(stems.stem[stems.level == 1])
    poked = int(first_level[np.argmax(stems.stem_length_m[first_level])])
    tip = np.flatnonzero(stems.stem == poked)[-1]
    row = int(np.argmin(np.linalg.norm(spectrum.grid.centres_m - stems.position[tip], axis=1)))
    nearest = np.argmin(
        np.linalg.norm(spectrum.grid.centres_m[:, None] - stems.position[None], axis=2), axis=1
    )  # voxel to node
    inside = _ancestors_and_descendants(stems, poked)[stems.stem[nearest]]

    knock = Impulse(at=contact_at_voxel(spectrum.grid, row), impulse_n_s=(5.0, 5.0, 0.0))
    pushed = generalised_force(system, knock, dt_s=1 / 30, num_frames=60)[:, None] / system.modal_mass
    frames, _ = run(exact_step(system, 1 / 30), State.at_rest(1, system.num_modes), pushed)
    velocity = np.diff(displacement(system.shapes, frames[:, 0]), axis=0)
    energy = (velocity**2).sum(axis=(0, 2))
    tree = branching(system)
    local = energy * poke_weights(tree, row, default_falloff_m(system)) ** 2
    assert energy[~inside].sum() > 0.8 * energy.sum()
    assert local[~inside].sum() < 0.05 * local.sum()


def _ancestors_and_descendants(stems, poked):
    above = np.full(len(stems.stem_length_m), -1)
    for node in np.flatnonzero(stems.parent >= 0):
        if stems.stem[stems.parent[node]] != stems.stem[node]:
            above[stems.stem[node]] = stems.stem[stems.parent[node]]

    def line(stem):
        while stem >= 0:
            yield stem
            stem = above[stem]

    up = set(line(poked))
    return np.array([stem in up or poked in line(stem) for stem in range(len(above))])
