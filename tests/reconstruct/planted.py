"""Splats of plants in scenes whose truth is known: in a pot on a table before a cloth, and on a lawn below a sky."""

import json
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np

from dynamictree.formats.mesh.ply_writer import write_ply
from dynamictree.formats.splat.ply import write_gaussian_ply
from dynamictree.gaussian.cloud import GaussianCloud, join_clouds
from dynamictree.gaussian.cloud_mesh import mesh_of_cloud
from dynamictree.gaussian.harmonics import SH_0
from dynamictree.gaussian.rasterize import render_on_cpu
from dynamictree.photo_requests import Scribble
from dynamictree.reconstruct.photo_cameras import PhotoCamera
from dynamictree.render.camera import Camera
from tests.formats.meshes import written
from tests.plant.test_still_gaussians import plant, pot, splat_of
from tests.reconstruct.finished import write_photos

WIDTH, HEIGHT = 240, 180
_NOISE_OF_COLOR = 0.04


@dataclass(frozen=True, kw_only=True)
class Planted:
    """A scene, which of its Gaussians are the plant, and where photos were taken."""

    scene: GaussianCloud
    owner: np.ndarray  # number of each Gaussian's part, the plant's being 0
    views: tuple[PhotoCamera, ...]
    held_out: tuple[PhotoCamera, ...]

    @property
    def plant(self) -> np.ndarray:
        return self.owner == 0

    def iou(self, own: np.ndarray) -> float:
        """Of where the chosen Gaussians are seen from the cameras held out, against where the plant is."""
        true, chosen = (
            np.array([mask_of(self.scene, one, view) for view in self.held_out]) for one in (self.plant, own)
        )
        return float((true & chosen).sum() / (true | chosen).sum())


def mask_of(scene: GaussianCloud, own: np.ndarray, view: PhotoCamera) -> np.ndarray:
    """Pixels that show the chosen Gaussians rather than the others, hidden parts left out."""
    colors = np.where(own, 0.5, -0.5)[:, None, None] / SH_0
    labels = replace(scene, sh=np.repeat(colors, 3, axis=2).astype(np.float32))
    picture = render_on_cpu(labels, view.camera, width=view.width, height=view.height)
    return picture.color[..., 0] > 0.5


def stroke_across(planted: Planted, part: int) -> Scribble:
    """A stroke along the longest row of pixels of a part, in the photo that shows most of it."""
    masks = [mask_of(planted.scene, planted.owner == part, view) for view in planted.views[::4]]
    view, mask = max(zip(planted.views[::4], masks, strict=True), key=lambda pair: pair[1].sum())
    row = int(mask.sum(axis=1).argmax())
    columns = np.flatnonzero(mask[row])
    low, high = columns[len(columns) // 8], columns[-1 - len(columns) // 8]
    points = tuple(((column + 0.5) / view.width, (row + 0.5) / view.height) for column in (low, high))
    return Scribble(photo=view.photo, plant=part == 0, points=points)


def photographed(target: np.ndarray, distance: float, arc_deg: float, number: int, first: int = 0) -> list[PhotoCamera]:
    """A walk in an arc around a place, the camera level and a little unsteady."""
    rng = np.random.default_rng(7 + first)
    views = []
    for turn in np.radians(arc_deg) * ((np.arange(number) + 0.5) / number - 0.5):
        place = target + distance * np.array([np.sin(turn), -np.cos(turn), 0.25 + 0.1 * rng.normal()])
        aimed = target + 0.05 * distance * rng.normal(size=3)
        camera = Camera.look_at(place, aimed, vertical_fov_deg=45.0)
        views.append(PhotoCamera(photo=f"{first + len(views):02d}.jpg", camera=camera, width=WIDTH, height=HEIGHT))
    return views


def coloured(cloud: GaussianCloud, color: tuple[float, float, float]) -> GaussianCloud:
    return replace(
        cloud, sh=np.tile(((np.float32(color) - 0.5) / SH_0).astype(np.float32), (cloud.num_gaussians, 1, 1))
    )


def as_learned(scene: GaussianCloud, spread: float, rng: np.random.Generator) -> GaussianCloud:
    """Uneven in place, size, opacity and colour, as what is learned from photos."""
    number = scene.num_gaussians
    return replace(
        scene,
        means=(scene.means + spread * rng.normal(size=(number, 3))).astype(np.float32),
        scales=np.maximum(scene.scales, np.float32(0.3 * spread))
        * rng.uniform(0.7, 1.5, (number, 1)).astype(np.float32),
        opacity=rng.uniform(0.5, 0.99, number).astype(np.float32),
        sh=(scene.sh + _NOISE_OF_COLOR / SH_0 * rng.normal(size=scene.sh.shape)).astype(np.float32),
    )


def ball(number: int, middle: list[float], radius: float, size: float, rng: np.random.Generator) -> GaussianCloud:
    """Round Gaussians scattered in a ball."""
    cloud = plant("shrub").subset(np.zeros(number, np.int64))
    places = radius / 2 * rng.normal(size=(number, 3)) + middle
    return replace(cloud, means=places.astype(np.float32), scales=np.full((number, 3), size, np.float32))


def sheet(low: list[float], u: list[float], v: list[float], number: int) -> GaussianCloud:
    """A flat parallelogram of round Gaussians."""
    a, b = np.meshgrid(*2 * [(np.arange(number) + 0.5) / number], indexing="ij")
    places = np.array(low) + a.reshape(-1, 1) * np.array(u) + b.reshape(-1, 1) * np.array(v)
    cloud = plant("shrub").subset(np.zeros(len(places), np.int64))
    size = 0.7 * max(np.linalg.norm(u), np.linalg.norm(v)) / number
    return replace(cloud, means=places.astype(np.float32), scales=np.full((len(places), 3), size, np.float32))


def _planted(parts: list[GaussianCloud], target: np.ndarray, distance: float, arc_deg: float) -> Planted:
    rng = np.random.default_rng(3)
    height = float(np.ptp(parts[0].means[:, 2]))
    scene = as_learned(join_clouds(parts), 0.004 * height, rng)
    order = rng.permutation(scene.num_gaussians)
    owner = np.repeat(np.arange(len(parts)), [part.num_gaussians for part in parts])
    return Planted(
        scene=scene.subset(order),
        owner=owner[order],
        views=tuple(photographed(target, distance, arc_deg, 16)),
        held_out=tuple(photographed(target, distance, 0.9 * arc_deg, 5, 100)),
    )


@cache
def potted() -> Planted:
    """A sapling in a pot on a table, books beside it, a cloth behind; photos from the front."""
    rng = np.random.default_rng(11)
    tree = plant("sapling")
    h = float(np.ptp(tree.means[:, 2]))
    table = coloured(sheet([-h, -0.8 * h, -0.26 * h], [2 * h, 0, 0], [0, 1.6 * h, 0], 80), (0.55, 0.38, 0.25))
    book = sheet([0.4 * h, -0.3 * h, -0.2 * h], [0.3 * h, 0, 0], [0, 0.25 * h, 0], 30)
    spine = sheet([0.4 * h, -0.3 * h, -0.25 * h], [0.3 * h, 0, 0], [0, 0, 0.05 * h], 30)
    cloth = coloured(sheet([-2 * h, 0.75 * h, -h], [4 * h, 0, 0], [0, 0.1 * h, 3 * h], 90), (0.85, 0.84, 0.8))
    parts = [
        tree,
        coloured(splat_of(*pot(0.15 * h, 0.25 * h)), (0.7, 0.35, 0.2)),
        table,
        coloured(join_clouds([book, spine]), (0.2, 0.3, 0.6)),
        cloth,
        coloured(ball(60, [0.7 * h, -0.4 * h, 0.6 * h], 0.1 * h, 0.01 * h, rng), (0.8, 0.8, 0.8)),
    ]
    return _planted(parts, np.array([0, 0, 0.4 * h]), 2.2 * h, 150.0)


@cache
def on_lawn() -> Planted:
    """A maple on a lawn, a bench that leans on its trunk, a hedge and sky behind; photos from all around."""
    rng = np.random.default_rng(12)
    tree = plant("maple")
    h = float(np.ptp(tree.means[:, 2]))
    lawn = coloured(sheet([-2.5 * h, -2.5 * h, 0], [5 * h, 0, 0], [0, 5 * h, 0], 120), (0.3, 0.42, 0.18))
    rough = 0.01 * h * rng.uniform(size=(lawn.num_gaussians, 1)) * [0, 0, 1]
    lawn = replace(lawn, means=(lawn.means + rough).astype(np.float32))
    bench = sheet([0.03 * h, -0.25 * h, 0.08 * h], [0.1 * h, 0, 0], [0, 0.35 * h, 0], 40)
    back = sheet([0.13 * h, -0.25 * h, 0.08 * h], [0.02 * h, 0, 0.09 * h], [0, 0.35 * h, 0], 40)
    turn = rng.uniform(0, 2 * np.pi, 5000)
    hedge = ball(5000, [0, 0, 0.2 * h], 0.2 * h, 0.03 * h, rng)
    around = 2.6 * h * np.stack([np.cos(turn), np.sin(turn), 0 * turn], axis=1)
    hedge = replace(hedge, means=(hedge.means + around).astype(np.float32))
    dome = rng.normal(size=(3000, 3))
    dome[:, 2] = np.abs(dome[:, 2])
    dome *= 15 * h / np.linalg.norm(dome, axis=1, keepdims=True)
    sky = replace(ball(3000, [0, 0, 0], h, 0.7 * h, rng), means=dome.astype(np.float32))
    parts = [
        tree,
        lawn,
        coloured(join_clouds([bench, back]), (0.45, 0.3, 0.18)),
        coloured(hedge, (0.2, 0.36, 0.15)),
        coloured(sky, (0.6, 0.75, 0.95)),
    ]
    return _planted(parts, np.array([0, 0, 0.45 * h]), 1.8 * h, 360.0)


def write_planted(planted: Planted, folder: Path) -> None:
    """Files of a finished reconstruction of the scene; the mesh is of all that is narrow."""
    folder.mkdir()
    narrow = planted.scene.subset(np.isin(planted.owner, (0, 2)))
    mesh = mesh_of_cloud(narrow, cells_along=100)
    (folder / "mesh.ply").write_bytes(written(write_ply, mesh))
    (folder / "scene.ply").write_bytes(written(write_gaussian_ply, planted.scene))
    write_photos(folder, planted.scene, list(planted.views))
    radius_m = float(np.ptp(planted.scene.means[planted.plant], axis=0).max())
    held_out = [planted.views[4].photo, planted.views[11].photo]
    report = {"scale": "unknown", "radius_m": radius_m, "num_photos": 16, "held_out": held_out, "warnings": []}
    (folder / "report.json").write_text(json.dumps(report))
