"""Gaussians of the background's colour around stems are dropped, the plant's own are not."""

from dataclasses import replace

import numpy as np

from dynamictree.gaussian.cloud import joined
from dynamictree.reconstruct.soot import soot_of
from tests.reconstruct.planted import coloured, potted

CLOTH = (0.85, 0.84, 0.8)


def test_gaussians_of_the_cloths_colour_around_the_plant_are_dropped() -> None:
    planted = potted()
    rng = np.random.default_rng(4)
    tree = planted.scene.subset(planted.plant)
    h = float(np.ptp(tree.means[:, 2]))
    high = tree.subset(np.flatnonzero(tree.means[:, 2] > 0.4 * h)[::12])  # before the cloth in all photos
    beside = (high.means + 0.015 * h * rng.normal(size=high.means.shape)).astype(np.float32)
    soot = replace(coloured(high, CLOTH), means=beside, opacity=np.full_like(high.opacity, 0.4))
    scene = joined([planted.scene, soot])
    is_soot = np.arange(scene.num_gaussians) >= planted.scene.num_gaussians
    plant = np.concatenate([planted.plant, np.zeros(soot.num_gaussians, np.bool_)])
    dropped = soot_of(scene, plant | is_soot, list(planted.views))
    assert dropped[is_soot].mean() > 0.8
    assert dropped[plant].mean() < 0.01
    assert not dropped[~plant & ~is_soot].any()


def test_a_plant_as_green_as_its_lawn_keeps_its_gaussians() -> None:
    planted = potted()
    green = coloured(planted.scene, (0.3, 0.42, 0.18))
    assert not soot_of(green, planted.plant, list(planted.views)).any()


def test_pale_leaves_between_leaves_of_nearly_their_colour_are_no_soot() -> None:
    planted = potted()
    tree, cloth = planted.scene.subset(planted.plant), coloured(planted.scene.subset(~planted.plant), CLOTH)
    darker = np.full(3, 1 / np.sqrt(3))
    halves = [
        coloured(tree.subset(np.arange(start, tree.num_gaussians, 2)), tuple(np.subtract(CLOTH, off * darker)))
        for start, off in ((0, 0.19), (1, 0.11))  # unlike the cloth, and so little apart from it that it may be soot
    ]
    scene = joined([cloth, *halves])
    is_plant = np.arange(scene.num_gaussians) >= cloth.num_gaussians
    assert soot_of(scene, is_plant, list(planted.views)).mean() < 0.01


def test_nothing_is_dropped_where_there_is_no_background() -> None:
    tree = potted().scene.subset(potted().plant)
    assert not soot_of(tree, np.ones(tree.num_gaussians, np.bool_), list(potted().views)).any()
