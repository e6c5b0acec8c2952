"""Faint Gaussians in the air are dropped, those on the plant are not."""

from dataclasses import replace

import numpy as np

from dynamictree.gaussian.cloud import joined
from dynamictree.reconstruct.plant_cut import faint_floaters
from tests.reconstruct.planted import potted


def test_faint_gaussians_in_the_air_and_strays_are_fog_and_those_on_the_plant_are_not() -> None:
    planted = potted()
    tree = planted.scene.subset(planted.plant)
    tree = replace(tree, opacity=np.full_like(tree.opacity, 0.9))
    h = float(np.ptp(tree.means[:, 2]))
    rng = np.random.default_rng(4)
    faint = replace(
        tree.subset(np.arange(0, tree.num_gaussians, 8)), opacity=np.full(-(-tree.num_gaussians // 8), 0.2, np.float32)
    )
    air = rng.uniform([-h, -h, 0], [h, h, 0.4 * h], (200, 3)).astype(np.float32)
    air = air[np.hypot(air[:, 0], air[:, 1]) > 0.7 * h]
    mist = replace(tree.subset(np.zeros(len(air), np.int64)), means=air, opacity=np.full(len(air), 0.2, np.float32))
    stray = replace(mist.subset(np.array([0])), means=np.float32([[1.2 * h, 0, 0.5 * h]]), opacity=np.float32([0.9]))
    scene = joined([tree, faint, mist, stray])
    fog = faint_floaters(scene, np.ones(scene.num_gaussians, np.bool_))
    number = tree.num_gaussians + faint.num_gaussians
    assert fog[number:].all()
    assert fog[:number].mean() < 0.005


def test_a_plant_of_faint_gaussians_has_no_fog() -> None:
    tree = potted().scene.subset(potted().plant)
    faint = replace(tree, opacity=np.full_like(tree.opacity, 0.3))
    assert not faint_floaters(faint, np.ones(tree.num_gaussians, np.bool_)).any()
