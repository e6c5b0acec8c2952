"""A base that is one surface with its plant stands still, and nothing of a plant is taken for one."""

import io
from collections.abc import Callable
from functools import cache

import numpy as np
import pytest
import trimesh
from scipy.ndimage import gaussian_filter, label
from skimage.measure import marching_cubes

from dynamictree.formats.gltf.motion import write_motion_glb
from dynamictree.formats.mesh_file import read_mesh
from dynamictree.mesh import TriangleMesh, connected_parts
from dynamictree.plant.pot import find_pot
from dynamictree.plant.still_mesh import find_still_parts
from dynamictree.up_axis import up_rotation
from lab.dataset.species import SPECIES
from tests.formats.meshes import written
from tests.plant.stand import grown

CELLS = 96
_THICK = 0.012  # standard deviation of the thickening of stems and leaves [share of the height]

Solid = Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]


def block(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
    return (np.abs(x) < 0.3) & (np.abs(y) < 0.25) & (z < 0.015) & (z > -0.06)


def pot(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
    away, wall = np.hypot(x, y), 0.16 + 0.16 * z
    low_shoot = (np.hypot(x - 0.09, y) < 0.02) & (z > 0) & (z < 0.2)
    return low_shoot | ((away < wall) & (z > -0.28) & ((z < 0.015) | ((away > wall - 0.03) & (z < 0.06))))


def ball(x: np.ndarray, y: np.ndarray, z: np.ndarray, *, middle: float = 0.7, radius: float = 0.3) -> np.ndarray:
    return x**2 + y**2 + (z - middle) ** 2 < radius**2


def frustum(
    below: float, above: float, low: float, high: float, at: tuple[float, float] = (0, 0)
) -> Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]:
    """Radii at two heights."""
    return lambda x, y, z: (
        (np.hypot(x - at[0], y - at[1]) < below + (above - below) * (z - low) / (high - low)) & (z > low) & (z < high)
    )


def flare(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
    return (np.hypot(x, y) < 0.06 + 0.15 * np.exp(-np.maximum(z, 0) / 0.04)) & (z > 0) & (z < 0.5)


plate = frustum(0.22, 0.22, -0.04, 0.015)
STEMS = np.random.default_rng(0).uniform(-0.15, 0.15, (15, 2))
PLANTS: dict[str, tuple[Solid, ...]] = {
    "a thin trunk below a ball": (frustum(0.05, 0.05, 0, 0.5), ball),
    "a thick trunk below a ball": (frustum(0.2, 0.2, 0, 0.5), ball),
    "a trunk shaped like a bottle": (frustum(0.25, 0.08, 0, 0.5), ball),
    "stems on a slender trunk": (frustum(0.08, 0.08, 0, 0.4), *(frustum(0.02, 0.02, 0, 1, at / 3) for at in STEMS[:3])),
    "roots that widen the foot": (flare, ball),
    "fifteen stems from the ground": (*(frustum(0.025, 0.02, 0, 0.6, (x, y)) for x, y in STEMS), ball),
    "a flat crown": (frustum(0.06, 0.06, 0, 0.3), frustum(0.4, 0.4, 0.3, 0.36), frustum(0.2, 0.05, 0.36, 1)),
    "a flat tier near the ground": (frustum(0.05, 0.05, 0, 1), frustum(0.4, 0.4, 0.15, 0.25), frustum(0.3, 0, 0.25, 1)),
    "branches in tiers": (
        frustum(0.05, 0.05, 0, 0.3),
        *(frustum(0.4 - 0.07 * tier, 0.1, 0.05 + 0.18 * tier, 0.3 + 0.18 * tier) for tier in range(5)),
    ),
    "leaves that hang all around": (
        lambda x, y, z: (np.hypot(x, y) < 0.54) & (np.abs(z - np.minimum(0.13, 0.324 - 0.6 * np.hypot(x, y))) < 0.018),
        frustum(0.05, 0.05, 0.13, 0.5),
    ),
    "a cone from the ground": (frustum(0.4, 0.02, 0, 1),),
    "a ball on the ground": (lambda x, y, z: ball(x, y, z, middle=0.5, radius=0.5),),
}


@cache
def skin(species: str, solid: Solid) -> TriangleMesh:
    """One closed surface around a grown tree and a solid below it, as meshes from pictures are; 1 m high."""
    tree = grown(species)
    foot = tree.vertices[:, 2].min()
    sampled = trimesh.Trimesh(tree.vertices, tree.faces, process=False).sample(150_000, seed=0)
    points = (sampled - [0, 0, foot]) / (tree.vertices[:, 2].max() - foot)
    low, high = np.minimum(points.min(axis=0), -0.35) - 0.06, np.maximum(points.max(axis=0), 0.35) + 0.06
    cell = float((high - low).max()) / CELLS
    centre = centres(low, high, cell)
    density = np.zeros(np.broadcast_shapes(*(axis.shape for axis in centre)), np.float32)
    row = tuple(np.floor((points - low) / cell).astype(int).T)
    density[row] = 1
    density = gaussian_filter(density, _THICK / cell)
    density = np.minimum(density / (0.5 * np.quantile(density[row], 0.1)), 3)
    density = np.maximum(density, 2 * gaussian_filter(solid(*centre).astype(np.float32), 0.7))
    pieces, _ = label(density > 1)
    density[pieces != 1 + np.argmax(np.bincount(pieces.ravel())[1:])] *= 0.3
    mesh = surface(density, low, cell)
    part = connected_parts(mesh.faces, mesh.num_vertices)[mesh.faces[:, 0]]
    return TriangleMesh(vertices=mesh.vertices, faces=mesh.faces[part == np.argmax(np.bincount(part))])


def centres(low: np.ndarray, high: np.ndarray, cell: float) -> list[np.ndarray]:
    places = np.ogrid[tuple(slice(count) for count in np.ceil((high - low) / cell).astype(int))]
    return [low[axis] + (place + 0.5) * cell for axis, place in enumerate(places)]


def surface(density: np.ndarray, low: np.ndarray, cell: float) -> TriangleMesh:
    places, faces, _, _ = marching_cubes(density, 1.0, gradient_direction="descent")
    return TriangleMesh(vertices=(low + (places + 0.5) * cell).astype(np.float32), faces=faces.astype(np.int32))


@pytest.mark.parametrize("solid", [plate, block, pot])
@pytest.mark.parametrize("species", ["round-broadleaf", "sapling", "shrub", "pine"])
def test_a_base_of_one_surface_with_its_plant_stands_still(species: str, solid: Solid) -> None:
    mesh = skin(species, solid)
    parts, still = find_still_parts(mesh)
    assert [part.name for part in parts] == ["pot" if solid is pot else "ground"]
    middle = mesh.vertices[mesh.faces].mean(axis=1)
    below = middle[:, 2] < -0.02
    assert still[below].all()
    assert not still[middle[:, 2] > 0.12].any()


@pytest.mark.parametrize("species", SPECIES)
def test_nothing_of_a_plant_that_is_one_surface_is_taken_for_a_base(species: str) -> None:
    assert find_still_parts(skin(species, lambda x, y, z: x + y + z > 99)) == ((), None)


@pytest.mark.parametrize("name", PLANTS)
def test_no_shape_of_a_plant_is_taken_for_a_base(name: str) -> None:
    low = np.array([-0.6, -0.6, -0.1])
    centre = centres(low, low + 1.2, 0.012)
    solid = np.logical_or.reduce(np.broadcast_arrays(*(part(*centre) for part in PLANTS[name])))
    assert find_still_parts(surface(2 * gaussian_filter(solid.astype(np.float32), 1.0), low, 0.012)) == ((), None)


def test_no_wall_is_searched_where_no_surface_faces_up(monkeypatch, rng) -> None:
    monkeypatch.setattr("dynamictree.plant.pot._wall", lambda points: pytest.fail("a wall was searched"))
    assert find_pot(rng.random((9000, 3)), 1.0, rng, rise=np.zeros(9000)) is None


@pytest.mark.parametrize(("side", "doubted"), [(1.0, True), (2.0, True), (1.1, False)])
def test_a_coloured_model_of_one_surface_that_a_tool_scaled_to_a_cube_is_doubted(side: float, doubted: bool) -> None:
    """As tools that make meshes from pictures write GLB: colours of vertices, no names, centred in a cube."""
    mesh = skin("sapling", pot)
    middle, longest = (mesh.vertices.min(axis=0) + mesh.vertices.max(axis=0)) / 2, np.ptp(mesh.vertices, axis=0).max()
    places = (mesh.vertices - middle) @ up_rotation("+Y") * side / longest
    colors = np.where(mesh.vertices[:, 2:] < 0.02, [150, 80, 60, 255], [70, 130, 50, 255]).astype(np.uint8)
    content = trimesh.Trimesh(places, mesh.faces, vertex_colors=colors, process=False).export(file_type="glb")
    read = read_mesh(io.BytesIO(content), file_type="glb")
    assert [part.name for part in read.parts.still] == ["pot"]
    assert [warning.code for warning in read.warnings] == ["size-doubtful"] * doubted
    content = written(write_motion_glb, read, np.zeros((read.num_vertices, 4, 3), np.complex64), num_frames=10)
    again = read_mesh(io.BytesIO(content), file_type="glb")  # trimesh reads no colours of 16 bits
    np.testing.assert_array_equal(*(np.array(one.look.vertex_colors)[:, :3] for one in (again, read)))
