"""The shape tells whether a tree is bare or in leaf."""

from dataclasses import replace

import numpy as np
import pytest

from dynamictree import method
from dynamictree.models.periods import PERIOD_S
from dynamictree.voxel.voxelize import SurfaceVoxels
from dynamictree.warm_up import pole
from lab.dataset.sapling import grow_tree
from lab.dataset.species import SPECIES


def voxels_of(species: str, height_m: float) -> SurfaceVoxels:
    own = replace(SPECIES[species], height_m=(height_m, height_m))
    return method.voxelize(grow_tree(own, np.random.default_rng(5)).mesh)


@pytest.mark.parametrize("height_m", [1.0, 30.0])
@pytest.mark.parametrize(("species", "foliage"), [("bare-winter", 0.0), ("birch", 1.0)])
def test_grown_trees_of_any_height_are_distinguished(species: str, foliage: float, height_m: float) -> None:
    voxels = voxels_of(species, height_m)
    assert method.generate(voxels, num_steps=1, period_s=PERIOD_S).foliage == pytest.approx(foliage, abs=0.1)


def test_a_request_is_believed_and_neither_clouds_nor_voxels_without_a_surface_tell() -> None:
    voxels = method.voxelize(pole())
    assert method.generate(voxels, num_steps=1).foliage is not None
    assert method.generate(voxels, num_steps=1, foliage=0.3).foliage == 0.3
    assert method.generate(voxels, num_steps=1, of_cloud=True).foliage is None
    assert method.generate(voxels, num_steps=1, of_cloud=True, foliage=0.3).foliage == 0.3
    assert method.generate(replace(voxels, moments=None), num_steps=1).foliage is None
