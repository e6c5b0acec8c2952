"""Only the plant of a splat or scan moves: ground, pots, things and floaters are found, and stand exactly still."""

from dataclasses import replace
from functools import cache
from io import BytesIO

import numpy as np
import pytest

from dynamictree.formats.description import describe_capture
from dynamictree.formats.tensors.bundle import read_cloud_bundle, write_bundle
from dynamictree.gaussian.animate import iter_poses
from dynamictree.gaussian.binding import bind
from dynamictree.gaussian.cloud import GaussianCloud
from dynamictree.gaussian.cloud import join_clouds as joined_clouds
from dynamictree.gaussian.from_mesh import splats_of_mesh
from dynamictree.mesh import TriangleMesh
from dynamictree.plant.capture import Capture, carrying_mesh, moving_part, with_still_parts
from dynamictree.plant.still_cloud import find_still_gaussians
from lab.dataset.species import SPECIES
from tests.devoxelize.test_interpolation import tube
from tests.formats.meshes import written
from tests.plant.stand import grown


@cache
def plant(species: str) -> GaussianCloud:
    """Splats of a generated tree, its foot at the origin."""
    mesh = grown(species)
    cloud = splats_of_mesh(mesh, per_face=1, at_least=30_000, rng=np.random.default_rng(0)).cloud
    cloud = replace(cloud, means=cloud.means - np.float32([0, 0, mesh.vertices[:, 2].min()]))
    return cloud.subset(np.arange(0, cloud.num_gaussians, 3))


def disc(radius: float, z: float, slope: float = 0.0) -> TriangleMesh:
    turn = np.linspace(0, 2 * np.pi, 24, endpoint=False)
    rim = np.stack([radius * np.cos(turn), radius * np.sin(turn), z + slope * radius * np.cos(turn)], axis=1)
    faces = np.stack([np.full(24, 24), np.arange(24), (np.arange(24) + 1) % 24], axis=1)
    return TriangleMesh(vertices=np.float32([*rim, [0, 0, z]]), faces=faces.astype(np.int32))


def pot(radius: float, height: float) -> list[TriangleMesh]:
    """A wall and soil in it, whose surface is at the origin; the wall is a little higher."""
    wall = tube([0, 0, -height], [0, 0, 0.1 * height], radius, rings=6, sides=24)
    outward = 1 + 0.15 * (wall.vertices[:, 2:] / height)  # wider at the top
    wall = wall.with_vertices((wall.vertices * np.hstack([outward, outward, np.ones_like(outward)])).astype(np.float32))
    return [wall, disc(0.97 * radius, 0.0)]


def scattered(radius: float, count: int, centre: list[float]) -> GaussianCloud:
    """A ball of Gaussians."""
    spots = np.random.default_rng(1).normal(size=(count, 3)) * radius / 2 + centre
    return replace(plant("shrub").subset(np.arange(count)), means=spots.astype(np.float32))


def joined(*clouds: GaussianCloud) -> tuple[GaussianCloud, np.ndarray]:
    """One cloud, and which of them each Gaussian is from."""
    return joined_clouds(clouds), np.repeat(np.arange(len(clouds)), [cloud.num_gaussians for cloud in clouds])


def splat_of(*meshes: TriangleMesh) -> GaussianCloud:
    rng = np.random.default_rng
    return joined_clouds([splats_of_mesh(mesh, per_face=1, at_least=5000, rng=rng(2)).cloud for mesh in meshes])


def height(cloud: GaussianCloud) -> float:
    return float(np.ptp(cloud.means[:, 2]))


SCENES = {
    "ground": lambda h: splat_of(disc(0.8 * h, 0.0, slope=0.05)),
    "pot": lambda h: splat_of(*pot(0.15 * h, 0.25 * h)),
    "floaters": lambda h: scattered(0.02 * h, 100, [1.2 * h, 0.3 * h, 0.7 * h]),
}


@cache
def potted() -> tuple[Capture, np.ndarray]:
    """A sapling in a pot, and which Gaussians are the pot's."""
    scene, owner = joined(plant("sapling"), SCENES["pot"](height(plant("sapling"))))
    return with_still_parts(Capture(cloud=scene)), owner == 1


@pytest.mark.parametrize("name", SCENES)
@pytest.mark.parametrize("species", ["maple", "sapling"])
def test_what_is_no_plant_is_found_and_the_plant_is_not(name: str, species: str) -> None:
    tree = plant(species)
    scene, owner = joined(tree, SCENES[name](height(tree)))
    parts, part_of = find_still_gaussians(scene)
    assert [part.name for part in parts] == [name]
    assert (part_of[owner == 1] > 0).mean() > 0.97
    assert (part_of[owner == 0] > 0).mean() < 0.02  # the foot, where it touches


def test_a_pot_on_a_table_and_a_cup_beside_it_are_found() -> None:
    tree = plant("sapling")
    h = height(tree)
    cup = splat_of(tube([0.6 * h, 0, -0.25 * h], [0.6 * h, 0, -0.2 * h], 0.04 * h, rings=4, sides=24))
    scene, owner = joined(tree, splat_of(*pot(0.15 * h, 0.25 * h)), splat_of(disc(h, -0.255 * h)), cup)
    parts, part_of = find_still_gaussians(scene)
    assert {part.name for part in parts} == {"ground", "pot", "things"}
    assert (part_of[owner > 0] > 0).mean() > 0.97
    assert (part_of[owner == 0] > 0).mean() < 0.02


@pytest.mark.parametrize("species", SPECIES)
def test_nothing_of_a_plant_is_taken_for_a_thing(species: str) -> None:
    assert find_still_gaussians(plant(species))[0] == ()


def test_still_gaussians_do_not_move_at_all() -> None:
    capture, of_pot = potted()
    mesh = carrying_mesh(capture)
    sway = 0.1 * mesh.vertices[:, 2:] / mesh.height_m * np.float32([1, 0, 0])  # the foot of a tree does not move
    binding = bind(capture.cloud, mesh, mask=moving_part(capture))
    still = ~moving_part(capture)
    assert still[of_pot].mean() > 0.97
    (pose,) = iter_poses(binding, iter([sway]))
    np.testing.assert_array_equal(pose.means[still], capture.cloud.means[still])
    moved = np.linalg.norm(pose.means - capture.cloud.means, axis=1)
    assert np.median(moved[~of_pot]) > 0.02
    assert mesh.vertices[:, 2].min() > -0.03 * height(plant("sapling"))  # no voxel is spent on the pot


def test_a_mask_is_taken_as_it_is() -> None:
    capture, of_pot = potted()
    assert moving_part(with_still_parts(Capture(cloud=capture.cloud, mask=of_pot | True))).all()


def test_a_mesh_that_came_with_a_capture_stands_still_where_its_gaussians_do() -> None:
    tree = plant("sapling")
    h = height(tree)
    ground = disc(0.8 * h, 0.0)
    scene, _ = joined(tree, splat_of(ground))
    foliage = tube([0, 0, 0.3 * h], [0, 0, 0.8 * h], 0.05 * h)
    vertices, faces = np.concatenate([ground.vertices, foliage.vertices]), [ground.faces, foliage.faces + 25]
    sent = TriangleMesh(vertices=vertices, faces=np.concatenate(faces).astype(np.int32))
    result = carrying_mesh(with_still_parts(Capture(cloud=scene, mesh=sent)))
    np.testing.assert_array_equal(result.still_faces, np.arange(sent.num_faces) < ground.num_faces)


def test_still_parts_survive_the_bundle_and_are_described() -> None:
    capture, _ = potted()
    again = read_cloud_bundle(BytesIO(written(write_bundle, capture)))
    assert again.still_parts == capture.still_parts
    np.testing.assert_array_equal(again.part_of, capture.part_of)
    (part,) = describe_capture(again)["still_parts"]
    assert part["name"] == "pot"
    assert int(part["num_gaussians"]) == (~moving_part(capture)).sum()
