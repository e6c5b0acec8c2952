"""Photos of a thing whose shape and cameras are known: taken by the project's own renderer."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from scipy.ndimage import zoom

from dynamictree.mesh import Material, MeshLook, TriangleMesh, join_meshes
from dynamictree.reconstruct.views import SparseModel, View
from dynamictree.render import Camera, Renderer, RenderSettings
from tests.formats.meshes import written

WIDTH, HEIGHT = 400, 300
POT_M = 0.55
SQUARE = np.int32([[0, 1, 2], [0, 2, 3]])


def sparse_model(views: Sequence[View] = (), points: Any = (), seen: Any = (), colors: Any = None) -> SparseModel:
    """As structure from motion gives it: points and pairs of a view's and a point's row; black unless stated."""
    places = np.reshape(points, (-1, 3))
    return SparseModel(
        views=tuple(views),
        points=places,
        colors=np.zeros_like(places, np.uint8) if colors is None else colors.astype(np.uint8),
        seen=np.reshape(seen, (-1, 2)).astype(np.int64),
        reprojection_error_px=0.5,
    )


@dataclass(frozen=True, kw_only=True)
class Orbit:
    """A stump on a patterned ground, and photos from around it."""

    stump: TriangleMesh
    cameras: tuple[Camera, ...]
    photos: tuple[Path, ...]


def patterned_png(rng: np.random.Generator, tint: tuple[int, int, int], side: int = 512) -> bytes:
    """Noise of several scales, so that a picture has corners near and far."""
    noise = sum(zoom(rng.normal(size=(side // cell, side // cell)), cell, order=1) for cell in (4, 8, 16, 64))
    grey = np.clip(0.55 + 0.13 * noise, 0.05, 1)[..., None]
    return written(Image.fromarray((grey * tint).astype(np.uint8)).save, format="PNG")


def textured(points: np.ndarray, faces: np.ndarray, uv: np.ndarray, png: bytes) -> TriangleMesh:
    look = MeshLook(
        uv=uv.astype(np.float32),
        face_material=np.zeros(len(faces), np.int32),
        materials=(Material(base_color=(1.0, 1.0, 1.0, 1.0), texture_png=png),),
    )
    return TriangleMesh(vertices=points.astype(np.float32), faces=faces.astype(np.int32), look=look)


def stump_and_ground(rng: np.random.Generator, *, potted: bool = False) -> list[TriangleMesh]:
    """A bulging column with a flat top, 1.2 m high, and 6 m of ground; its lower half is blue and a part if potted."""
    turn, level = np.meshgrid(np.linspace(0, 1, 97), np.linspace(0, 1, 41), indexing="ij")
    radius = (0.42 + 0.06 * np.sin(6 * np.pi * turn) - 0.12 * level) * np.minimum(1, 6 * (1 - level) ** 0.5)
    angle = 2 * np.pi * turn
    points = np.stack([radius * np.cos(angle), radius * np.sin(angle), 1.2 * level], axis=2).reshape(-1, 3)
    index = np.arange(97 * 41).reshape(97, 41)
    a, b, c, d = index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]
    faces = np.concatenate([np.stack([a, b, c], axis=2), np.stack([a, c, d], axis=2)]).reshape(-1, 3)
    uv = np.stack([turn, 1 - 0.5 * level], axis=2).reshape(-1, 2)
    bark, lawn = patterned_png(rng, (230, 190, 140)), patterned_png(rng, (170, 210, 150), side=1024)
    corners = 3 * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    ground = textured(corners, SQUARE, np.array([[0, 1], [1, 1], [1, 0], [0, 0]]), lawn)
    if not potted:
        return [textured(points, faces, uv, bark), ground]
    low, glaze = points[faces].mean(axis=1)[:, 2] < POT_M, patterned_png(rng, (110, 140, 235))
    return [textured(points, faces[~low], uv, bark), textured(points, faces[low], uv, glaze), ground]


@pytest.fixture
def coarse(monkeypatch: pytest.MonkeyPatch) -> None:
    """Extract surfaces of plants on a grid with half the cells along each side."""
    monkeypatch.setattr("dynamictree.reconstruct.coloured_mesh.CELLS", 208)


@pytest.fixture(scope="session")
def orbit(tmp_path_factory) -> Orbit:
    return photographed(tmp_path_factory.mktemp("photos"))


def photographed(folder: Path, *, potted: bool = False) -> Orbit:
    """Fourteen photos from around and a little above."""
    parts = stump_and_ground(np.random.default_rng(5), potted=potted)
    renderer = Renderer(join_meshes(parts), RenderSettings(width=WIDTH, height=HEIGHT, ground=False))
    cameras, photos = [], []
    for number in range(14):
        turn = np.radians(number * 360 / 14)
        position = np.array([2.9 * np.cos(turn), 2.9 * np.sin(turn), 1.3 + 0.3 * (number % 2)])
        camera = Camera.look_at(position, np.array([0.0, 0, 0.5]), vertical_fov_deg=38.0)
        path = folder / f"photo_{number:02d}.jpg"
        Image.fromarray(renderer.picture(camera=camera)).save(path, quality=95)
        cameras.append(camera)
        photos.append(path)
    return Orbit(stump=join_meshes(parts[:-1]), cameras=tuple(cameras), photos=tuple(photos))
