"""The mesh of a plant that is cut out of a scene has no holes."""

from pathlib import Path

import numpy as np
import pytest

from dynamictree.mesh import TriangleMesh
from dynamictree.photo_requests import CutParams
from dynamictree.reconstruct.recut import recut
from tests.reconstruct.planted import on_lawn, potted, write_planted


def num_open_edges(mesh: TriangleMesh) -> int:
    """Edges of one face alone."""
    sides = np.sort(mesh.faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    return int((np.unique(sides, axis=0, return_counts=True)[1] == 1).sum())


@pytest.mark.parametrize("planted", [potted, on_lawn])
def test_a_plant_that_is_cut_out_is_closed_and_whole(planted, tmp_path: Path) -> None:
    """Faces whose nearest Gaussian was no plant left holes: 0 boundary loops became 812 on a fern."""
    folder = tmp_path / "finished"
    write_planted(planted(), folder)
    capture = recut(folder, folder, CutParams(only_plant=True))
    assert capture.mesh is not None
    assert num_open_edges(capture.mesh) == 0
    own = capture.cloud.means[capture.cloud.opacity > 0.6]
    low, high = capture.mesh.vertices.min(axis=0) - 0.02, capture.mesh.vertices.max(axis=0) + 0.02
    assert ((own >= low) & (own <= high)).all(axis=1).mean() > 0.97
