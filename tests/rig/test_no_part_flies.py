"""No part flies: what hangs loosely on a tree moves as the voxels around it and stays where it hangs."""

import numpy as np
import pytest

from dynamictree import method
from dynamictree.devoxelize.attachment import find_attachments
from dynamictree.mesh import TriangleMesh, weld
from dynamictree.spectrum import SparseVoxelSpectrum, to_motion
from dynamictree.voxel.grid import VoxelGrid
from dynamictree.voxel.voxelize import voxelize
from tests.devoxelize.test_interpolation import merged, tube


def card(middle: np.ndarray, across: np.ndarray) -> TriangleMesh:
    """A square of two triangles; `across` are its two half diagonals."""
    corners = middle + np.concatenate([across, -across])
    return TriangleMesh(vertices=corners.astype(np.float32), faces=np.array([[0, 1, 2], [0, 2, 3]], np.int32))


def crowd(seed: int, num_cards: int, size_m: float, spread_m: float) -> tuple[TriangleMesh, np.ndarray]:
    """A trunk of 10 m amid cards at random; and which of them each vertex is from, 0 being the trunk."""
    rng = np.random.default_rng(seed)
    middles = rng.normal(size=(num_cards, 3)) * spread_m + [0, 0, 6]
    diagonals = rng.normal(size=(num_cards, 2, 3)) * size_m * rng.uniform(0.1, 1, (num_cards, 1, 1))
    return merged(tube([0, 0, 0], [0, 0, 10], 0.2), *map(card, middles, diagonals))


def sway(grid: VoxelGrid, seed: int, noise: float) -> np.ndarray:
    """Spectra that grow with height, with noise from voxel to voxel."""
    rng = np.random.default_rng(seed)
    size = 0.1 * (grid.centres_m[:, 2] / grid.centres_m[:, 2].max()) ** 2
    drawn = 1 + noise * rng.normal(size=(len(grid), 4, 3, 2))
    drawn[:, 0, :, 1] = 0  # a mean is real
    return np.ascontiguousarray(size[:, None, None, None] * drawn, np.float32).view(np.complex64)[..., 0]


def on_vertices(grid: VoxelGrid, mesh: TriangleMesh, coefficients: np.ndarray, num_frames: int) -> np.ndarray:
    """Displacement of the vertices [T, N, 3] by the rig of a motion of the voxels [m], without leaves' own flutter."""
    spectrum = SparseVoxelSpectrum(grid=grid, coefficients=coefficients, num_frames=num_frames)
    return np.stack(list(method.move(spectrum, mesh, flutter=0.0)))


def most_of_voxels_around(points: np.ndarray, grid: VoxelGrid, reached: np.ndarray) -> np.ndarray:
    """A slow loop: the most of the voxels within one of each point's, or of the nearest occupied one."""
    most = np.zeros(len(points))
    for i, coords in enumerate(grid.coords_of(points)):
        away = np.abs(grid.coords - coords).max(axis=1)
        home = grid.coords[np.argmin(((grid.centres_m - points[i]) ** 2).sum(axis=1))] if away.min() > 0 else coords
        most[i] = reached[np.abs(grid.coords - home).max(axis=1) <= 1].max()
    return most


@pytest.mark.parametrize(
    ("seed", "num_cards", "size_m", "spread_m", "noise"),
    [
        (0, 1, 0.05, 0.3, 0.0),
        (1, 20, 0.15, 1.0, 0.0),
        (2, 20, 0.3, 1.0, 0.3),
        (3, 40, 1.0, 3.0, 0.3),
        (4, 40, 0.3, 0.3, 3.0),
        (5, 40, 1.0, 1.0, 3.0),
        (6, 1, 0.15, 3.0, 0.0),
        (7, 10, 1.0, 3.0, 0.0),
    ],
)
def test_no_vertex_moves_far_from_the_voxels_around_it(
    seed: int, num_cards: int, size_m: float, spread_m: float, noise: float
) -> None:
    """Rigid cards and rings of a trunk are where their voxels are in the mean, and 1.2 times as far at most.

    But for corners of cards as long as a tenth of the tree, 1 in 130 of these: no turn brings all to their voxels.
    """
    mesh, _ = crowd(seed, num_cards, size_m, spread_m)
    grid = voxelize(mesh, 64).grid
    coefficients = sway(grid, seed, noise)
    moved = on_vertices(grid, mesh, coefficients, 100)
    reached, farthest = (np.linalg.norm(m, axis=2).max(axis=0) for m in (to_motion(coefficients, 100), moved))
    around = most_of_voxels_around(mesh.vertices, grid, reached)
    assert (farthest <= 1.2 * around + 0.001 * 10).mean() > 0.99
    assert (farthest <= 1.6 * around + 0.001 * 10).all()


def test_a_loose_part_with_a_small_share_of_its_voxels_does_not_fly() -> None:
    """A twig of 3.5 voxels beside a trunk whose voxels it shares: it makes up for nothing."""
    trunk = tube([0, 0, 0], [0, 0, 10], 0.2, sides=24)
    mesh, owner = merged(trunk, tube([0.21, 0, 7], [0.21, 0, 7.27], 0.0005, rings=2, sides=3))
    grid = voxelize(mesh, 128).grid
    coefficients = sway(grid, 0, 0.3)
    moved = on_vertices(grid, mesh, coefficients, 40)
    beside = (owner == 0) & (np.abs(mesh.vertices[:, 2] - 7.1) < 0.5)
    reached = np.linalg.norm(moved, axis=2).max(axis=0)
    assert reached[owner == 1].max() < 1.2 * reached[beside].max()


@pytest.mark.parametrize("size_m", [0.05, 0.2, 1.0])
def test_a_card_stays_where_it_hangs(size_m: float) -> None:
    """The gap between a card and the trunk grows by no more than 0.3 % of the height, through noise of voxels."""
    heights_m = np.random.default_rng(0).uniform(3, 9, 20)
    cards = [card(np.array([0.2 + 0.9 * size_m, 0, z]), size_m * np.eye(3)[:2]) for z in heights_m]
    mesh, _ = merged(tube([0, 0, 0], [0, 0, 10], 0.2), *cards)
    grid = voxelize(mesh, 128).grid
    moved = on_vertices(grid, mesh, sway(grid, 1, 0.3), 40)
    rest, gap = (gaps_m(mesh, grid, some) for some in ([mesh.vertices], mesh.vertices + moved))
    assert gap.shape == (40, 20)
    assert np.percentile((gap - rest).max(axis=0), 99) < 0.003 * 10


def gaps_m(mesh: TriangleMesh, grid: VoxelGrid, places: np.ndarray) -> np.ndarray:
    """Distance between the two ends of each attachment, over the frames [T, C]."""
    welded, vertex = weld(mesh)
    attachments, place = find_attachments(welded, grid), np.array(places)[:, np.unique(vertex, return_index=True)[1]]
    ends = np.einsum("bsi,tbsic->tbsc", attachments.weights, place[:, attachments.corners])
    return np.linalg.norm(ends[:, :, 0] - ends[:, :, 1], axis=2)


def attached(mesh: TriangleMesh, owner: np.ndarray) -> dict[int, int]:
    """On which of the merged meshes each one hangs."""
    welded, vertex = weld(mesh)
    of_vertex = np.empty(welded.num_vertices, np.int64)
    of_vertex[vertex] = owner
    attachments = find_attachments(welded, voxelize(mesh, 128).grid)
    return {int(of_vertex[own[0]]): int(of_vertex[other[0]]) for own, other in attachments.corners}


def test_a_leader_hangs_on_a_trunk_no_longer_or_in_parts_and_a_second_stem_stands() -> None:
    ends = ([0, 0, 0], [0, 0, 10]), ([0, 0, 2], [2, 0, 10]), ([1, 0, 6], [4, 0, 9]), ([0.3, 0, 0], [-3, 0, 9])
    assert attached(*merged(*(tube(*stem, 0.15) for stem in ends))) == {1: 0, 2: 1}
    pile = [tube([0, 0, z], [0, 0, z + 2], 0.3 - z / 50, rings=2, sides=8) for z in range(0, 10, 2)]
    branches = [tube([0.25, 0, z], [4, 0, z + 2], 0.08, rings=2) for z in (3, 5, 9)]
    assert attached(*merged(*pile, *branches)) == {1: 0, 2: 1, 3: 2, 4: 3, 5: 1, 6: 2, 7: 4}


def test_a_card_hangs_on_the_twig_near_it_and_not_on_the_next_card() -> None:
    """Cards of 0.8 m in a chain, 1.2 to 2 voxels from one another, 3 from the trunk: each is the trunk's."""
    across = 0.4 * np.eye(3)[1:]
    chain = [card(np.array([0.2 + 3 * 10 / 128, 0.0, 5 + 0.95 * i]), (1 + 0.01 * i) * across) for i in range(5)]
    assert attached(*merged(tube([0, 0, 0], [0, 0, 10], 0.2), *chain)) == dict.fromkeys(range(1, 6), 0)


def test_a_card_hangs_on_the_small_twig_that_it_touches_and_not_on_the_branch_beside_it() -> None:
    """A card of 0.4 m on a twig of 0.3 m, 1.5 voxels from a branch that is clearly larger."""
    twig = tube([1.0, 0.05, 6], [1.0, 0.35, 6], 0.02, rings=3, sides=6)
    leaf = card(np.array([1.2, 0.34, 6]), 0.2 * np.eye(3)[:2] @ np.array([[1, 1, 0], [1, -1, 0], [0, 0, 1.0]]))
    assert attached(*merged(tube([0, 0, 0], [0, 0, 10], 0.2), tube([0.3, 0, 6], [2.5, 0, 6], 0.05), twig, leaf))[3] == 2


def test_a_twig_hangs_on_a_branch_and_not_on_the_large_leaf_that_it_touches() -> None:
    branch = tube([0.3, 0, 6], [2.5, 0, 6], 0.05)
    twig = tube([1.0, 0.12, 6], [1.0, 0.4, 6], 0.02, rings=3, sides=6)
    leaf = card(np.array([1.0, 0.3, 6.01]), 0.6 * np.eye(3)[:2])
    assert attached(*merged(tube([0, 0, 0], [0, 0, 10], 0.2), branch, twig, leaf))[2] == 1


def test_what_has_no_foot_hangs_where_it_crosses_the_tree() -> None:
    ends = ([0, 0, 0], [0, 0, 10]), ([0.15, 0, 6], [2, 0, 7]), ([-1, 0.2, 3], [1, 0.2, 3]), ([-6, 0, 10], [6, 0, 10])
    assert attached(*merged(*(tube(*stem, 0.08, rings=10, sides=8) for stem in ends))) == dict.fromkeys((1, 2, 3), 0)


def test_a_trunk_does_not_hang_on_its_crown() -> None:
    """A trunk of six sides below a larger crown: its foot would follow the crown."""
    trunk, crown = tube([0, 0, 0], [0, 0, 4], 0.2, rings=2, sides=6), tube([0, 0, 3.9], [0, 0, 10], 0.3)
    assert 0 not in attached(*merged(trunk, crown))


@pytest.mark.parametrize(("rings", "z"), [(40, 6), (2, 4)])
def test_the_foot_of_a_branch_stays_in_the_bark(rings: int, z: float) -> None:
    """Where it hangs it moves as the bark there and tilts with it, to 0.3 % of the height, through noise of voxels."""
    trunk = tube([0, 0, 0], [0, 0, 10], 0.3, rings=rings, sides=12)
    mesh, _ = merged(trunk, tube([0.28, 0, z], [2.5, 0, z + 1], 0.12, rings=12, sides=8))
    grid = voxelize(mesh, 128).grid
    coefficients, even = sway(grid, 1, 0.3), sway(grid, 1, 0.0)
    arm, branch = grid.centres_m[:, None] - np.array([0.28, 0, z]), np.hypot(*grid.centres_m[:, :2].T) > 0.4
    bark = even[np.argmin(np.linalg.norm(arm, axis=2))]
    coefficients[branch] += (bark + np.cross(np.cross([0, 0, 2 / z], bark), arm) - even)[branch]
    gap = gaps_m(mesh, grid, on_vertices(grid, mesh, coefficients, 40))
    assert gap.shape[1] == 1
    assert gap.max() < 0.003 * 10


def test_parts_do_not_carry_one_another_in_a_circle() -> None:
    """Far from the trunk, a small lump on a large one, and a card near the small one: the large one is on no card."""
    lumps = (tube([x, 0, z], [x, 0, z + 2 * r], r, rings=2) for x, z, r in ((4, 5.8, 0.2), (4.1, 6.2, 0.125)))
    sheet = card(np.array([4.3, 0, 6.33]), 0.5 * np.eye(3)[1:])
    assert attached(*merged(tube([0, 0, 0], [0, 0, 10], 0.2), *lumps, sheet)) == {2: 1, 3: 2}
