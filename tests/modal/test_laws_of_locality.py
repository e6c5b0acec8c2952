"""What a poke may reach."""

import numpy as np
import pytest

from dynamictree.errors import InputError
from dynamictree.modal.force import Impulse, contact_at_voxel, generalised_force
from dynamictree.modal.interactive_tree import ForceGroup, InteractiveTree, Locality
from dynamictree.modal.step import State, exact_step, run
from dynamictree.modal.system import default_falloff_m, displacement, modal_system
from dynamictree.rig.rig import rig_of
from lab.dataset.sample import make_sample, voxel_spectrum


def poke_weights(tree, row, falloff_m):
    (weights,) = tree.weights([ForceGroup(locality=Locality(seed_voxel=row, falloff_m=falloff_m))])
    return weights


def test_what_the_poked_branch_carries_rides_with_it(forked):
    tree, parts = forked
    weights = poke_weights(tree, int(parts["right"][15]), 0.5)
    np.testing.assert_allclose(weights[parts["right"][15:]], 1, atol=0.02)


def test_ancestors_move_less_the_nearer_to_the_root(forked):
    tree, parts = forked
    weights = poke_weights(tree, int(parts["right"][9]), 0.5)
    down = weights[np.concatenate([parts["stem"], parts["right"][:10]])]
    assert (np.diff(down) >= -1e-6).all()
    assert down[0] < 0.01
    assert 0.3 < weights[parts["stem"][-1]] < 1


def test_other_branches_barely_move(forked):
    tree, parts = forked
    weights = poke_weights(tree, int(parts["right"][30]), 0.5)
    fork_weight = weights[parts["stem"][-1]]
    assert weights[parts["left"]].max() <= fork_weight
    assert weights[parts["left"][15:]].max() < 0.01


def test_a_larger_falloff_reaches_further(forked):
    tree, parts = forked
    near, far = (poke_weights(tree, int(parts["right"][30]), falloff) for falloff in (0.3, 1.0))
    assert (far >= near).all()
    assert far.sum() > near.sum() + 1


def test_an_endless_falloff_is_the_whole_tree(forked):
    tree, parts = forked
    np.testing.assert_allclose(poke_weights(tree, int(parts["right"][30]), 1e6), 1, atol=1e-6)


@pytest.mark.parametrize(("row", "falloff_m"), [(-1, 1.0), (10**6, 1.0), (0, 0.0), (0, float("nan"))])
def test_a_poke_that_is_none_is_refused(forked, row, falloff_m):
    with pytest.raises(InputError):
        poke_weights(forked[0], row, falloff_m)


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
    tree = InteractiveTree(system, rig_of(sample.mesh, spectrum), sample.mesh)
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
