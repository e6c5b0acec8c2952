"""Gaussians of the background's colour around stems are dropped, the plant's own are not."""

from dataclasses import replace

import numpy as np

from dynamictree.gaussian.cloud import joined
from dynamictree.reconstruct.floaters import background_floaters, faint_floaters
from tests.reconstruct.planted import coloured, potted

CLOTH = (0.85, 0.84, 0.8)


def test_gaussians_of_the_cloths_colour_around_the_plant_are_dropped() -> None:
    planted = potted()
    rng = np.random.default_rng(4)
    tree = planted.scene.subset(planted.plant)
    h = float(np.ptp(tree.means[:, 2]))
    high = tree.subset(np.flatnonzero(tree.means[:, 2] > 0.4 * h)[::12])  # before the cloth in all photos
    beside = (high.means + 0.015 * h * rng.normal(size=high.means.shape)).astype(np.float32)
    floaters = replace(coloured(high, CLOTH), means=beside, opacity=np.full_like(high.opacity, 0.4))
    scene = joined([planted.scene, floaters])
    is_floater = np.arange(scene.num_gaussians) >= planted.scene.num_gaussians
    plant = np.concatenate([planted.plant, np.zeros(floaters.num_gaussians, np.bool_)])
    dropped = background_floaters(scene, plant | is_floater, list(planted.views))
    assert dropped[is_floater].mean() > 0.8
    assert dropped[plant].mean() < 0.01
    assert not dropped[~plant & ~is_floater].any()


def test_a_plant_as_green_as_its_lawn_keeps_its_gaussians() -> None:
    planted = potted()
    green = coloured(planted.scene, (0.3, 0.42, 0.18))
    assert not background_floaters(green, planted.plant, list(planted.views)).any()


def test_pale_leaves_between_leaves_of_nearly_their_colour_are_no_soot() -> None:
    planted = potted()
    tree, cloth = planted.scene.subset(planted.plant), coloured(planted.scene.subset(~planted.plant), CLOTH)
    darker = np.full(3, 1 / np.sqrt(3))
    halves = [
        coloured(tree.subset(np.arange(start, tree.num_gaussians, 2)), tuple(np.subtract(CLOTH, off * darker)))
        for start, off in (
            (0, 0.19),
            (1, 0.11),
        )  # unlike the cloth, and so little apart from it that they may float
    ]
    scene = joined([cloth, *halves])
    is_plant = np.arange(scene.num_gaussians) >= cloth.num_gaussians
    assert background_floaters(scene, is_plant, list(planted.views)).mean() < 0.01


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


def test_nothing_is_dropped_where_there_is_no_background() -> None:
    tree = potted().scene.subset(potted().plant)
    assert not background_floaters(tree, np.ones(tree.num_gaussians, np.bool_), list(potted().views)).any()
