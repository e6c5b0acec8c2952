"""What the network sees turns with the tree, and tells the stems apart."""

from dataclasses import replace

import numpy as np
import pytest
import torch
import trimesh

from dynamictree.mesh import TriangleMesh
from dynamictree.models.small.amplitude import amplitude_inputs, mirror_inputs
from dynamictree.models.small.features import (
    TreeFeatures,
    batch_features,
    coarsen_features,
    node_features,
    tree_features,
    turn_features,
    wind_vector,
)
from dynamictree.models.small.foliage import ARM, NUM_FOLIAGE_VALUES
from dynamictree.models.small.surface_shape import eigenvalues
from dynamictree.models.small.voxel_skeleton import FOOT_VOXELS, section_radius, skeleton_of
from dynamictree.spectrum import Wind
from dynamictree.voxel.graph import voxel_graph
from dynamictree.voxel.grid import VoxelGrid
from dynamictree.voxel.moments import AREA, NORMAL, OFFSET, SIX, SPREAD
from dynamictree.voxel.voxelize import SurfaceVoxels, voxelize
from lab.small.train_foliage import SIDES

WIND = wind_vector([Wind(speed_m_s=7.0, direction_deg=37.0, gust=0.2)])


def is_mirror(axes: tuple[int, int, int], signs: tuple[int, int, int]) -> bool:
    """A turn keeps left and right apart, a mirror exchanges them."""
    odd = axes != (0, 1, 2)
    return (signs[0] * signs[1] < 0) != odd


@pytest.mark.parametrize("side", SIDES)
def test_inputs_turn_with_tree_and_wind(tree: TreeFeatures, side: tuple[tuple[int, ...], tuple[int, ...]]) -> None:
    axes, signs = side
    heading = WIND[:, 2:][:, list(axes[:2])] * torch.tensor(signs[:2])
    wind = torch.cat([WIND[:, :2], heading], dim=1)  # turned with its tree
    foliage_values = torch.randn(len(tree.scalars), NUM_FOLIAGE_VALUES, generator=torch.Generator().manual_seed(0))
    turned_values = foliage_values.clone()
    turned_values[:, ARM] = foliage_values[:, ARM][:, list(axes)] * torch.tensor(signs)
    turned = amplitude_inputs(turn_features(tree, axes, signs), turned_values, wind)
    straight = amplitude_inputs(tree, foliage_values, WIND)
    torch.testing.assert_close(turned, mirror_inputs(straight) if is_mirror(axes, signs) else straight)


def test_a_turned_tree_is_measured_like_the_tree_turned(voxels: SurfaceVoxels, tree: TreeFeatures) -> None:
    axes, signs = (1, 0, 2), (-1, 1, 1)
    coords = voxels.grid.coords[:, [1, 0, 2]] * np.array(signs) + np.array([127, 0, 0])
    grid = VoxelGrid.from_coords(coords.astype(np.int32), origin_m=(-6.4, -6.4, 0.0), voxel_size_m=0.1, resolution=128)
    rows = grid.rows_of(coords.astype(np.int32))
    normals = np.empty_like(voxels.normals)
    normals[rows] = voxels.normals[:, [1, 0, 2]] * np.array(signs, np.float32)
    moments = np.empty_like(voxels.moments)
    moments[rows] = turned_moments(voxels.moments)
    measured = tree_features(SurfaceVoxels(grid=grid, normals=normals, moments=moments))
    turned = turn_features(tree, axes, signs)
    heights = [0, 1, 2, 3, 4]  # what does not depend on which of two equally short ways to the root is taken
    torch.testing.assert_close(measured.scalars[rows][:, heights], turned.scalars[:, heights], atol=2e-3, rtol=1e-3)
    torch.testing.assert_close(measured.vectors[rows][:, [0, 3]], turned.vectors[:, [0, 3]], atol=1e-5, rtol=1e-4)
    torch.testing.assert_close(measured.surface[rows], turned.surface, atol=1e-4, rtol=1e-4)
    torch.testing.assert_close(measured.tensors[rows], turned.tensors, atol=1e-4, rtol=1e-4)


def turned_moments(moments: np.ndarray) -> np.ndarray:
    """By the side ((1, 0, 2), (-1, 1, 1)): x is −y of before, y is x."""
    xx, yy, zz, xy, xz, yz = range(6)
    six, sign = [yy, xx, zz, xy, yz, xz], np.array([1, 1, 1, -1, -1, 1], np.float32)
    offset = moments[:, OFFSET][:, [1, 0, 2]] * np.float32([-1, 1, 1])
    return np.concatenate(
        [moments[:, AREA], offset, moments[:, SPREAD][:, six] * sign, moments[:, NORMAL][:, six] * sign], axis=1
    )


def test_eigenvalues_are_lapacks() -> None:
    rng = np.random.default_rng(0)
    full = rng.normal(size=(200, 3, 3))
    full = full + full.transpose(0, 2, 1)
    full[0] = 0
    full[1] = np.eye(3)
    full[2] = np.diag([1, 1, 0])
    six = np.stack([full[:, i, j] for i, j in SIX], axis=1)
    np.testing.assert_allclose(eigenvalues(six), np.linalg.eigvalsh(full), atol=1e-7)


def test_without_a_mesh_every_voxel_is_a_card_and_says_so(voxels: SurfaceVoxels, tree: TreeFeatures) -> None:
    blind = tree_features(replace(voxels, moments=None))
    assert (tree.surface[:, -1] == 1).all()
    assert (blind.surface[:, -1] == 0).all()
    torch.testing.assert_close(blind.surface[:, 4:6], torch.tensor([0.0, 1.0]).expand(len(voxels.grid), 2))
    torch.testing.assert_close(blind.scalars, tree.scalars)


def test_a_batch_is_its_trees(tree: TreeFeatures) -> None:
    other = turn_features(tree, (0, 1, 2), (-1, 1, 1))
    winds = torch.cat([WIND, wind_vector([Wind(direction_deg=200.0)])])
    foliage_values = torch.randn(2, len(tree.scalars), NUM_FOLIAGE_VALUES)
    together = amplitude_inputs(batch_features([tree, other]), foliage_values.flatten(0, 1), winds)
    apart = torch.cat(
        [amplitude_inputs(tree, foliage_values[0], winds[:1]), amplitude_inputs(other, foliage_values[1], winds[1:])]
    )
    torch.testing.assert_close(together, apart)
    assert (batch_features([tree, other]).chain[len(tree.chain) :] == tree.chain + len(tree.scalars)).all()
    links = batch_features([tree, other]).links
    assert (links[: len(tree.links)] == tree.links).all()
    assert (links[len(tree.links) :] == tree.links + len(tree.scalars)).all()


def test_nodes_carry_their_voxels_mean_and_the_links_between_them(tree: TreeFeatures) -> None:
    nodes = coarsen_features(tree, 2)
    owner = tree.grids.parents[1][tree.grids.parents[0]]
    features, coarse = node_features(tree, WIND), node_features(nodes, WIND)
    children = [torch.isin(tree.grids.parents[0], torch.where(tree.grids.parents[1] == 3)[0])]
    assert (owner[children[0]] == 3).all()
    assert coarse[3, 0] == pytest.approx(float(features[owner == 3, 0].mean()), abs=0.02)
    assert (nodes.links[:, 0] != nodes.links[:, 1]).all()
    assert set(map(tuple, nodes.links.tolist())) <= set(map(tuple, owner[tree.links].tolist()))


def test_the_skeleton_finds_the_stems_of_a_fork(fork: VoxelGrid) -> None:
    skeleton = skeleton_of(fork, voxel_graph(fork))
    tips = {
        name: int(fork.rows_of(np.array([at], np.int32))[0])
        for name, at in {"trunk": (64, 64, 60), "long": (30, 64, 90), "short": (64, 80, 70)}.items()
    }
    # the root goes on into the branch that reaches furthest; the trunk's own end and the short branch leave it
    assert skeleton.level[tips["long"]] == 0
    assert skeleton.level[tips["trunk"]] >= 1
    assert skeleton.level[tips["short"]] >= 1
    assert skeleton.reach_m[tips["long"]] == 0
    root = int(fork.rows_of(np.array([(64, 64, 2)], np.int32))[0])
    assert skeleton.num_beyond[root] >= len(fork) - 3
    assert skeleton.stem_length_m[tips["long"]] == pytest.approx(skeleton.distance_m[tips["long"]])
    assert fork.coords[skeleton.base[tips["short"]], 0] == 64


def test_a_stems_foot_is_where_it_has_left_its_bearer(fork: VoxelGrid) -> None:
    skeleton = skeleton_of(fork, voxel_graph(fork))
    tip = int(fork.rows_of(np.array([(64, 80, 70)], np.int32))[0])
    foot = skeleton.foot[tip]
    assert skeleton.base[foot] == skeleton.base[tip]
    out_m = skeleton.distance_m[foot] - skeleton.stem_start_m[foot]
    assert 0 < out_m < FOOT_VOXELS * fork.voxel_size_m
    assert skeleton.distance_m[foot] < skeleton.distance_m[tip]


@pytest.mark.parametrize("radius", [4, 7, 11])
def test_a_stem_is_as_thick_as_it_is(radius: int) -> None:
    angle = np.linspace(0, 2 * np.pi, 400)
    height = np.arange(60)
    ring = np.stack([64 + radius * np.cos(angle), 64 + radius * np.sin(angle)], axis=1).round()
    thick = np.concatenate(
        [np.broadcast_to(ring, (60, 400, 2)).reshape(-1, 2), np.repeat(height, 400)[:, None]], axis=1
    )
    twig = np.stack([np.full(60, 64 + radius + 6), np.full(60, 64), height], axis=1)  # close by, of its own
    grid = VoxelGrid.from_coords(
        np.concatenate([thick, twig]).astype(np.int32), origin_m=(-6.4, -6.4, 0.0), voxel_size_m=0.1, resolution=128
    )
    graph = voxel_graph(grid)
    result = section_radius(grid, graph, skeleton_of(grid, graph).distance_m, None)
    middle = (grid.coords[:, 2] > 20) & (grid.coords[:, 2] < 50)
    on_twig = grid.coords[:, 0] == 64 + radius + 6
    np.testing.assert_allclose(np.median(result[middle & ~on_twig]), (radius + 0.5) * 0.1, rtol=0.1)
    assert np.median(result[middle & on_twig]) < 0.1


@pytest.mark.parametrize("radius_m", [0.003, 0.01, 0.3])
def test_a_twig_thinner_than_a_voxel_is_as_thick_as_its_surface_says(radius_m: float) -> None:
    """A vertical tube of 6 m in voxels of 0.1 m."""
    tube = trimesh.creation.cylinder(radius_m, height=6.0, sections=16)
    voxels = voxelize(TriangleMesh.from_trimesh(tube), 64)
    graph = voxel_graph(voxels.grid)
    distance_m = skeleton_of(voxels.grid, graph).distance_m
    area_m2 = voxels.moments[:, 0].astype(np.float64) * voxels.grid.voxel_size_m**2
    result = section_radius(voxels.grid, graph, distance_m, area_m2)
    inside = (distance_m > 1) & (distance_m < 5)
    assert np.median(result[inside]) == pytest.approx(radius_m, rel=0.3)
