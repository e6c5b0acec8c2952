"""Only the plant moves: pots, planes, stones and named things are found, and stand exactly still."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from trimesh.creation import box, icosphere, revolve
from trimesh.geometry import align_vectors

from dynamictree import method
from dynamictree.mesh import Material, TriangleMesh
from dynamictree.plant.names import is_still_name
from dynamictree.plant.still_mesh import find_still_parts
from dynamictree.spectrum import SparseVoxelSpectrum
from dynamictree.voxel.voxelize import voxelize
from lab.dataset.species import SPECIES
from tests.devoxelize.test_interpolation import merged, tube
from tests.plant.stand import grown


def still_faces_of(mesh: TriangleMesh) -> np.ndarray | None:
    return find_still_parts(mesh)[1]


def with_materials(mesh: TriangleMesh, of_face: np.ndarray, *names: str) -> TriangleMesh:
    materials = tuple(Material(name=name) for name in names)
    return replace(mesh, look=replace(mesh.look, face_material=of_face.astype(np.int32), materials=materials))


def tree(species: str = "round-broadleaf") -> TriangleMesh:
    mesh = grown(species)
    lifted = mesh.vertices - mesh.vertices.min(axis=0) * np.float32([0, 0, 1])
    return TriangleMesh(vertices=lifted, faces=mesh.faces)


def plane(side: float, z: float) -> TriangleMesh:
    corners = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) * side / 2 + [0, 0, z]
    return TriangleMesh(vertices=corners.astype(np.float32), faces=np.array([[0, 1, 2], [0, 2, 3]], np.int32))


def pot(radius: float, height: float, z: float) -> TriangleMesh:
    return tube([0, 0, z], [0, 0, z + height], radius, rings=4, sides=24)


THINGS = {
    "a plane of forty heights": lambda h: plane(40 * h, 0.01),
    "a vast plane above a plant's foot": lambda h: plane(40 * h, 0.3 * h),
    "a patch of ground": lambda h: plane(1.5 * h, 0.0),
    "a pot": lambda h: pot(0.15 * h, 0.25 * h, -0.2 * h),
    "a pot of soil on a block": lambda h: merged(pot(0.15 * h, 0.25 * h, -0.2 * h), plane(0.2 * h, 0), TriangleMesh.from_trimesh(box((0.8 * h, h, h)).apply_translation([0, 0, -0.7 * h])))[0],  # noqa: E501
    "a stone beside it": lambda h: replace(pot(0.03 * h, 0.05 * h, 0), vertices=pot(0.03 * h, 0.05 * h, 0).vertices + np.float32([h, 0, 0])),  # noqa: E501
    "a lattice of round rods": lambda h: merged(
        *(tube([h, side * h, 0], [h, side * h, 0.8 * h], 0.01 * h, rings=2) for side in (-0.2, 0, 0.2)),
        *(tube([h, -0.3 * h, up * h], [h, 0.3 * h, up * h], 0.01 * h, rings=2) for up in (0.3, 0.5, 0.7)),
    )[0],
}  # fmt: skip


@pytest.mark.parametrize("thing", THINGS.values(), ids=THINGS)
def test_what_is_no_plant_is_found_and_nothing_else(thing: Callable[[float], TriangleMesh]) -> None:
    plant = tree()
    scene, owner = merged(plant, thing(plant.height_m))
    np.testing.assert_array_equal(still_faces_of(scene), owner[scene.faces[:, 0]] == 1)


@pytest.mark.parametrize("species", SPECIES)
def test_nothing_of_a_plant_is_taken_for_a_thing(species: str) -> None:
    assert still_faces_of(tree(species)) is None


def test_a_plant_in_a_scene_moves_as_it_does_alone_and_the_scene_stands_still() -> None:
    plant = tree("palm")
    scene, owner = merged(plant, plane(40 * plant.height_m, 0.01), pot(0.1 * plant.height_m, 0.8, -0.7))
    scene = replace(scene, still_faces=still_faces_of(scene))
    grid, alone = voxelize(scene, 32).grid, voxelize(plant, 32).grid
    np.testing.assert_array_equal(grid.coords, alone.coords)  # all voxels are the plant's
    rng = np.random.default_rng(0)
    size = 0.1 * (grid.centres_m[:, 2] / plant.height_m)[:, None, None]
    spectrum = (size * (1 + 0.1 * rng.normal(size=(len(grid), 4, 3)))).astype(np.complex64)
    moved, by_itself = (
        method.devoxelize(SparseVoxelSpectrum(grid=grid, coefficients=spectrum), mesh) for mesh in (scene, plant)
    )
    assert not moved[owner > 0].any()
    np.testing.assert_allclose(moved[owner == 0], by_itself, atol=0.02 * np.abs(by_itself).max())


@pytest.mark.parametrize("detail", [1, 2, 3])
@pytest.mark.parametrize("radius", [0.15, 0.4])
@pytest.mark.parametrize("overlap", [-0.01, 0.05, 0.1, 0.3])
def test_a_trunk_below_a_round_crown_is_no_pot(detail: int, radius: float, overlap: float) -> None:
    """A tree of few faces: a tube, and a ball that it reaches into or touches with a corner."""
    ball = icosphere(subdivisions=detail, radius=2.0)
    ball.apply_transform(align_vectors(ball.vertices[0], [0, 0, -1]))
    ball.apply_translation([0, 0, 4 - overlap])
    crown = TriangleMesh(vertices=ball.vertices.astype(np.float32), faces=ball.faces.astype(np.int32))
    scene, owner = merged(tube([0, 0, 0], [0, 0, 2], radius), crown)
    assert still_faces_of(scene) is None
    assert still_faces_of(with_materials(scene, owner[scene.faces[:, 0]], "Material.001", "Material.002")) is None


def test_a_trunk_of_pieces_with_lids_is_no_pot() -> None:
    outline = [place for z in np.arange(0, 6, 1.2) for place in ((0, z), (0.5, z), (0.4, z + 1.2), (0, z + 1.2))]
    assert still_faces_of(TriangleMesh.from_trimesh(revolve(np.array(outline), sections=12))) is None


def test_a_stem_that_stands_on_a_solid_pot_leaves_it_still() -> None:
    stem, crown = tube([0, 0, 0], [0, 0, 3], 0.1), tube([0, 0, 2.5], [0, 0, 4], 1.0)
    scene, owner = merged(stem, crown, pot(0.6, 0.8, -0.8))
    of_pot = owner[scene.faces[:, 0]] == 2
    np.testing.assert_array_equal(still_faces_of(with_materials(scene, of_pot, "Material", "Material.001")), of_pot)


@pytest.mark.parametrize("soil", ["dirt", "phong8"])
def test_a_pot_higher_than_its_plant_stands_still_with_its_soil(soil: str) -> None:
    rosette = tube([0, 0, 0.62], [0, 0, 1.1], 0.5)
    scene, owner = merged(rosette, pot(0.4, 0.65, 0), tube([0, 0, 0.55], [0, 0, 0.6], 0.36))
    of_face = owner[scene.faces[:, 0]]
    np.testing.assert_array_equal(still_faces_of(with_materials(scene, of_face, "green", "phong7", soil)), of_face > 0)


def test_faces_without_height_beside_none_that_rise_are_no_ground() -> None:
    """Warnings of numpy are errors here: nothing is divided by a height of 0."""
    assert still_faces_of(TriangleMesh(vertices=np.float32([[1, 2, 3]]), faces=np.zeros((1, 3), np.int32))) is None


def test_straight_stems_beside_each_other_are_no_lattice() -> None:
    stems = [tube([0.2 * x, 0, 0], [0.2 * x, 0, 3], 0.02, rings=2) for x in range(6)]
    assert still_faces_of(merged(*stems, tree())[0]) is None


def test_names_of_things_are_words() -> None:
    assert all(map(is_still_name, ("Flower_Pot.001", "potMaterial", "Ground", "waterSurface", "M_Soil", "Jardinière")))
    assert not any(map(is_still_name, ("Bark_Mat", "Leaves", "Potentilla", "basecolor", "tree_material", "")))


def test_a_named_part_stands_still_whatever_its_shape() -> None:
    plant = tree()
    scene, owner = merged(plant, tube([1, 0, 0], [1, 0, 3], 0.1))
    of_face = owner[scene.faces[:, 0]]
    np.testing.assert_array_equal(still_faces_of(with_materials(scene, of_face, "Oak", "garden_fence")), of_face == 1)
