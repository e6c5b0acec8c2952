import numpy as np
import pytest

from dynamictree.mesh import MeshLook, TriangleMesh


def _ball(centre: tuple[float, float, float], radius_m: float, num_rings: int = 12) -> tuple[np.ndarray, np.ndarray]:
    polar, around = np.meshgrid(
        np.linspace(0.02, np.pi - 0.02, num_rings), np.arange(2 * num_rings) / num_rings * np.pi, indexing="ij"
    )
    points = np.stack([np.sin(polar) * np.cos(around), np.sin(polar) * np.sin(around), np.cos(polar)], axis=2)
    index = np.arange(points.shape[0] * points.shape[1]).reshape(points.shape[:2])
    a, b = index[:-1], index[1:]
    c, d = np.roll(b, -1, axis=1), np.roll(a, -1, axis=1)
    faces = np.concatenate([np.stack([a, b, c], axis=2), np.stack([a, c, d], axis=2)]).reshape(-1, 3)
    return points.reshape(-1, 3) * radius_m + centre, faces


@pytest.fixture
def two_balls() -> TriangleMesh:
    """A red ball before a blue one, seen from −Y, and a long needle of a triangle through both."""
    near, near_faces = _ball((0.2, -1.0, 1.0), 0.6)
    far, far_faces = _ball((-0.3, 0.5, 1.1), 0.9)
    needle = np.array([[-1.5, -0.9, 0.1], [1.5, -0.2, 2.0], [1.5, -0.2, 2.02]])
    vertices = np.concatenate([near, far, needle]).astype(np.float32)
    all_faces = [near_faces, far_faces + len(near), np.arange(3)[None] + len(near) + len(far)]
    colors = np.uint8([[220, 40, 30, 255], [30, 60, 200, 255], [240, 240, 240, 255]])
    look = MeshLook(vertex_colors=colors.repeat([len(near), len(far), 3], axis=0))
    return TriangleMesh(vertices=vertices, faces=np.concatenate(all_faces, dtype=np.int32), look=look)


def facing_card(z: float = 0.0, *, y: float = 0.0, half_m: float = 1.0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """An upright square that faces −Y: vertices, faces and texture coordinates (v downward)."""
    vertices = np.array(
        [[-half_m, y, z - half_m], [half_m, y, z - half_m], [half_m, y, z + half_m], [-half_m, y, z + half_m]],
        np.float32,
    )
    uv = np.array([[0, 1], [1, 1], [1, 0], [0, 0]], np.float32)
    return vertices, np.array([[0, 1, 2], [0, 2, 3]], np.int32), uv
