"""Trees of any two heights in one file move together, each at its own pace, and every product shows both."""

from dataclasses import replace
from functools import cache
from typing import get_args

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from dynamictree import method
from dynamictree.export.write import write_products
from dynamictree.mesh import TriangleMesh, join_meshes
from dynamictree.models import periods
from dynamictree.models.paper.network import PaperNetwork, paper_preset
from dynamictree.models.several_trees import tree_voxels
from dynamictree.models.weights_file import write_weights
from dynamictree.requests import ExportParams, Format, Shot
from dynamictree.spectrum import SparseVoxelSpectrum
from tests.plant.stand import tree


def pair_of(left_m: float, right_m: float) -> TriangleMesh:
    """Two trees side by side, labelled."""
    left, right = tree(left_m, num_cards=12), tree(right_m, seed=1, num_cards=12)
    both = join_meshes([left, right.with_vertices(right.vertices + np.float32([0.4 * (left_m + right_m), 0, 0]))])
    return replace(both, face_tree=np.repeat(np.int32([0, 1]), [left.num_faces, right.num_faces]))


@cache
def moving_pair(left_m: float, right_m: float) -> tuple[TriangleMesh, SparseVoxelSpectrum]:
    mesh = pair_of(left_m, right_m)
    return mesh, method.generate(method.voxelize(mesh), num_steps=1)


def assert_each_moves_as_alone(mesh: TriangleMesh, spectrum: SparseVoxelSpectrum, model: str = "small") -> None:
    """The spectrum of a pair holds, on the rows of each tree, that of the tree by itself in the pair's period."""
    voxels = method.voxelize(mesh)
    for number in (0, 1):
        rows = np.flatnonzero(voxels.tree == number)
        own = tree_voxels(voxels, rows)
        alone = method.generate(own, seed=number, num_steps=1, model=model, period_s=spectrum.period_s).coefficients
        if len(alone) == len(rows):
            np.testing.assert_array_equal(spectrum.coefficients[rows, : alone.shape[1]], alone)
            assert not spectrum.coefficients[rows, alone.shape[1] :].any()
        assert np.abs(spectrum.coefficients[rows, 1:]).max() > 0


@settings(max_examples=1, deadline=None)
@given(st.floats(1, 35), st.floats(1, 35))
@example(24.0, 7.5)
@example(1.0, 35.0)
def test_trees_of_any_two_heights_move_together(left_m: float, right_m: float) -> None:
    assert_each_moves_as_alone(*moving_pair(left_m, right_m))


def test_a_dense_tree_beside_a_light_one_leaves_out_its_own_flutter(monkeypatch) -> None:
    mesh = pair_of(24.0, 16.0)
    voxels = method.voxelize(mesh)
    dense = int(np.bincount(voxels.tree).max())
    monkeypatch.setattr(periods, "MAX_VALUES", 30 * dense)  # as for a tree of a million voxels
    assert_each_moves_as_alone(mesh, method.generate(voxels, num_steps=1))


def test_a_paper_s_model_moves_two_trees_on_a_grid_finer_than_its_own(tmp_path) -> None:
    voxels = method.voxelize(pair_of(8.0, 4.0), resolution=256)
    write_weights(PaperNetwork(paper_preset(8, 32)), tmp_path / "paper.safetensors")
    spectrum = method.generate(voxels, num_steps=1, model=str(tmp_path / "paper.safetensors"))
    assert len(spectrum.tree) == len(spectrum.grid)
    assert [np.abs(spectrum.coefficients[spectrum.tree == number, 1:]).max() > 0 for number in (0, 1)] == [True] * 2


@pytest.mark.parametrize(
    ("heights_m", "fps", "formats"),
    [((1.0, 35.0), 3.0, get_args(Format)[:12]), ((24.0, 7.5), 2.0, get_args(Format)[12:])],
)
def test_every_product_shows_a_tall_tree_and_a_small_one(
    heights_m: tuple[float, float], fps: float, formats: tuple[Format, ...], tmp_path
) -> None:
    mesh, spectrum = moving_pair(*heights_m)
    params = ExportParams(formats=formats, fps=fps, share=0.1, shot=Shot(side_px=64))
    paths = write_products(mesh, spectrum, params, tmp_path)
    assert {name for name, path in paths.items() if path.stat().st_size > 100} == set(formats)
