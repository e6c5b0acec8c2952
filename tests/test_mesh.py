"""Triangle meshes: what is refused, and edges."""

import numpy as np
import pytest

from dynamictree import mesh as mesh_module
from dynamictree.errors import MeshError
from dynamictree.mesh import TriangleMesh, edges_of, validate_mesh

CORNERS = np.array([[0, 0, 0], [1, 0, 0], [0, 0, 2]], np.float32)


def mesh_of(vertices: np.ndarray = CORNERS, faces: list[list[int]] | None = None) -> TriangleMesh:
    return TriangleMesh(
        vertices=vertices.astype(np.float32),
        faces=np.array([[0, 1, 2]] if faces is None else faces, np.int32).reshape(-1, 3),
    )


def test_a_sound_mesh_is_given_back() -> None:
    mesh = mesh_of()
    assert validate_mesh(mesh) is mesh
    assert mesh.height_m == 2


@pytest.mark.parametrize(
    ("mesh", "message"),
    [
        (mesh_of(faces=[]), "3 vertices and 0 faces"),
        (mesh_of(CORNERS[:2], [[0, 1, 0]]), "2 vertices"),
        (mesh_of(CORNERS * [np.nan, 1, 1]), "3 vertices are not finite, the first is vertex 0"),
        (mesh_of(CORNERS + np.array([[0, 0, 0], [0, np.inf, 0], [0, 0, 0]])), "the first is vertex 1"),
        (mesh_of(faces=[[0, 1, 3]]), "names vertex 3, but the vertices are 0 to 2"),
        (mesh_of(faces=[[0, 1, -1]]), "names vertex -1"),
        (mesh_of(CORNERS * 0 + 5), "one point"),
        (mesh_of(CORNERS + 1e7), "move it nearer"),
    ],
)
def test_a_mesh_that_cannot_be_used_is_refused(mesh: TriangleMesh, message: str) -> None:
    with pytest.raises(MeshError, match=message):
        validate_mesh(mesh)


@pytest.mark.parametrize("cap", ["MAX_FACES", "MAX_VERTICES"])
def test_a_mesh_over_a_cap_is_refused(monkeypatch, cap: str) -> None:
    monkeypatch.setattr(mesh_module, cap, 0)
    with pytest.raises(MeshError, match="decimate"):
        validate_mesh(mesh_of())


def test_edges_are_those_of_a_slow_search_each_once(rng) -> None:
    faces = rng.integers(0, 30, (80, 3)).astype(np.int32)
    expected = sorted({tuple(sorted((int(f[i]), int(f[(i + 1) % 3])))) for f in faces for i in range(3)})
    assert [tuple(edge) for edge in edges_of(faces).tolist()] == expected
