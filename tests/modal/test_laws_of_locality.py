"""What a poke may reach."""

import numpy as np
import pytest

from dynamictree.errors import InputError
from dynamictree.modal.interactive_tree import ForceGroup, Locality


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


def test_an_endless_falloff_is_the_whole_tree(forked):
    tree, parts = forked
    np.testing.assert_allclose(poke_weights(tree, int(parts["right"][30]), 1e6), 1, atol=1e-6)


@pytest.mark.parametrize(("row", "falloff_m"), [(-1, 1.0), (10**6, 1.0), (0, 0.0), (0, float("nan"))])
def test_a_poke_that_is_none_is_refused(forked, row, falloff_m):
    with pytest.raises(InputError):
        poke_weights(forked[0], row, falloff_m)
