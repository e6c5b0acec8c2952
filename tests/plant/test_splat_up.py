"""A splat whose file names no axis is turned until what the plant stands on is level, and only then."""

import io
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from dynamictree.formats.source_file import read_capture
from dynamictree.formats.splat.ply import write_gaussian_ply
from dynamictree.formats.splat.splat import write_splat
from dynamictree.gaussian.axes import to_source_axes, transform_cloud
from dynamictree.gaussian.cloud import GaussianCloud, join_clouds
from dynamictree.plant.capture import Capture, moving_part
from dynamictree.plant.sample import surface_points
from dynamictree.plant.splat_up import up_of_standing
from dynamictree.requests import Reading
from dynamictree.source import Source
from dynamictree.up_axis import up_rotation
from tests.formats.meshes import written
from tests.plant.stand import grown
from tests.plant.test_still_gaussians import plant, pot, splat_of
from tests.reconstruct.planted import sheet

TILTED = [("round-broadleaf", (-20, 15)), ("maple", (10, 0)), ("palm", (30, -20))]


@cache
def standing(species: str, *, ground: bool, slope_deg: float = 0.0) -> GaussianCloud:
    tree = plant(species)
    height = float(np.ptp(tree.means[:, 2]))
    lawn = sheet([-height, -height, -0.005 * height], [2 * height, 0, 0], [0, 2 * height, 0], 110)
    rough = lawn.means + 0.004 * height * np.random.default_rng(0).normal(size=lawn.means.shape).astype(np.float32)
    slope = Rotation.from_euler("x", slope_deg, degrees=True).as_matrix()
    return join_clouds([tree, transform_cloud(replace(lawn, means=rough), slope, 1.0)]) if ground else tree


def read(cloud: GaussianCloud, tilt_deg: tuple[float, float], reading: Reading | None = None) -> Capture:
    """As a file with -Y up that names no axis, after a tilt."""
    turn = Rotation.from_euler("xy", tilt_deg, degrees=True).as_matrix()
    content = written(write_splat, replace(transform_cloud(cloud, turn, 1.0), source=Source(up_axis="-Y")))
    return read_capture(io.BytesIO(content), file_type="splat", reading=reading)


def tilt_left_deg(capture: Capture, tilt_deg: tuple[float, float]) -> float:
    """Between +Z as read and what was up before the tilt."""
    turn = Rotation.from_euler("xy", tilt_deg, degrees=True).as_matrix()
    up = up_rotation(capture.cloud.source.up_axis) @ up_rotation("-Y").T @ turn @ [0, 0, 1]
    return float(np.degrees(np.arccos(np.clip(up[2], -1, 1))))


def levelled(capture: Capture) -> bool:
    return "levelled" in [warning.code for warning in capture.warnings]


@pytest.mark.parametrize(("species", "tilt_deg"), [*TILTED, *((species, (0, 0)) for species, _ in TILTED)])
def test_a_tree_on_its_ground_stands_upright(species: str, tilt_deg: tuple[float, float]) -> None:
    capture = read(standing(species, ground=True), tilt_deg)
    assert tilt_left_deg(capture, tilt_deg) < 2
    assert levelled(capture) == (tilt_deg != (0, 0))
    still = ~moving_part(capture)
    assert abs(still.sum() - 110**2) < 0.1 * 110**2, "the ground stands still, which a tilted one does not"


@pytest.mark.parametrize("species", ["round-broadleaf", "weeping", "palm"])
def test_a_tree_without_ground_stays_as_it_is(species: str) -> None:
    assert not levelled(read(standing(species, ground=False), (12, 0)))


@pytest.mark.parametrize("species", ["spreading-broadleaf", "spire-conifer", "acacia"])
def test_the_side_of_a_crown_is_nothing_that_a_tree_stands_on(species: str) -> None:
    """Points spread evenly over leaves and wood, tilted to four sides."""
    sampled = surface_points(grown(species), 20_000)
    for turn in np.arange(4) * np.pi / 2:
        tilt = Rotation.from_rotvec(np.radians(40) * np.array([np.cos(turn), np.sin(turn), 0]))
        assert up_of_standing(tilt.apply(sampled[0])) is None


@pytest.mark.parametrize("species", ["maple", "palm"])
def test_a_tree_on_a_slope_is_not_tipped(species: str) -> None:
    assert not levelled(read(standing(species, ground=True, slope_deg=15), (0, 0)))


@pytest.mark.parametrize(
    ("tilt_deg", "bottom"), [((10, 0), True), ((20, 15), False), ((-25, 25), True), ((-25, 25), False)]
)
def test_a_pot_that_stands_on_nothing_is_upright(tilt_deg: tuple[float, float], *, bottom: bool) -> None:
    tree = plant("sapling")
    height = float(np.ptp(tree.means[:, 2]))
    side = 0.2 * height
    below = sheet([-side / 2, -side / 2, -0.25 * height], [side, 0, 0], [0, side, 0], 40)
    wall = splat_of(*pot(0.15 * height, 0.25 * height))
    capture = read(join_clouds([tree, wall, below] if bottom else [tree, wall]), tilt_deg)
    assert levelled(capture)
    assert tilt_left_deg(capture, tilt_deg) < 5


def test_who_names_the_axis_is_right() -> None:
    scene, tilt_deg = standing("shrub", ground=True), (-20, 15)
    given = read(scene, tilt_deg, Reading(up_axis="-Y"))
    assert given.cloud.source.up_axis == "-Y"
    assert not levelled(given)
    again = read_capture(io.BytesIO(written(write_gaussian_ply, read(scene, tilt_deg).cloud)), file_type="ply")
    assert not levelled(again)
    assert tilt_left_deg(again, tilt_deg) < 2


@pytest.mark.parametrize("opacity", [0.05, 0.5])
def test_what_shows_nothing_or_one_point_stays_as_it_is(opacity: float) -> None:
    tree = plant("shrub")
    faint = replace(
        tree, opacity=np.full_like(tree.opacity, opacity), means=np.zeros_like(tree.means) + np.float32(1e6)
    )
    assert up_of_standing(faint.means[faint.opacity > 0.1].astype(np.float64)) is None
    assert not levelled(read(replace(tree, opacity=faint.opacity), (0, 0)))


def test_what_is_written_lies_as_the_file_lay() -> None:
    scene, tilt_deg = standing("shrub", ground=True), (-20, 15)
    as_given = read(scene, tilt_deg, Reading(up_axis="-Y", unit_m=1)).cloud
    turned = read(scene, tilt_deg, Reading(unit_m=1)).cloud
    assert np.abs(to_source_axes(turned).means - to_source_axes(as_given).means).max() < 1e-4 * np.ptp(scene.means)
    assert np.abs(to_source_axes(turned).sh - to_source_axes(as_given).sh).max() < 1e-4
