"""Files of a finished reconstruction whose shape is known: a stem between floor and lamp."""

import json
from pathlib import Path

import numpy as np

from dynamictree.formats.mesh.ply_writer import write_ply
from dynamictree.formats.splat.ply import write_gaussian_ply
from dynamictree.gaussian.cloud import GaussianCloud
from dynamictree.gaussian.rasterize import render_on_cpu
from dynamictree.mesh import TriangleMesh
from dynamictree.reconstruct.photo_cameras import PhotoCamera, write_cameras
from dynamictree.reconstruct.photo_previews import write_photo_previews
from dynamictree.reconstruct.views import View
from dynamictree.render.camera import Camera
from tests.clouds import cloud_at
from tests.formats.meshes import written

BOX = ((-0.3, -0.3, 0.2), (0.3, 0.3, 1.5))
NUM_STEM, NUM_FLOOR, NUM_LAMP = 200, 300, 100
CAMERA = Camera.look_at(np.array([2.0, 0.5, 1.0]), np.array([0.0, 0.0, 0.8]), vertical_fov_deg=60.0)


def tube(radius: float, low: float, high: float) -> tuple[np.ndarray, np.ndarray]:
    turn, level = np.meshgrid(np.linspace(0, 2 * np.pi, 13), np.linspace(low, high, 41), indexing="ij")
    points = np.stack([radius * np.cos(turn), radius * np.sin(turn), level], axis=2).reshape(-1, 3)
    index = np.arange(13 * 41).reshape(13, 41)
    a, b, c, d = index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]
    return points, np.concatenate([np.stack([a, b, c], 2), np.stack([a, c, d], 2)]).reshape(-1, 3)


def write_finished(folder: Path) -> None:
    """Gaussians of a stem of 1 m, a floor below and a lamp above; the mesh lacks the lamp."""
    folder.mkdir()
    rng = np.random.default_rng(0)
    stem, stem_faces = tube(0.03, 0.3, 1.3)
    floor, floor_faces = tube(1.0, 0.0, 0.05)
    vertices = np.concatenate([stem, floor]).astype(np.float32)
    faces = np.concatenate([stem_faces, floor_faces + len(stem)]).astype(np.int32)
    (folder / "mesh.ply").write_bytes(written(write_ply, TriangleMesh(vertices=vertices, faces=faces)))
    means = np.concatenate(
        [
            np.stack([0 * np.arange(NUM_STEM), 0 * np.arange(NUM_STEM), np.linspace(0.3, 1.3, NUM_STEM)], axis=1),
            np.concatenate([rng.uniform(-1, 1, (NUM_FLOOR, 2)), np.zeros((NUM_FLOOR, 1))], axis=1),
            np.array([0, 0, 2.2]) + 0.08 * rng.normal(size=(NUM_LAMP, 3)),
        ]
    ).astype(np.float32)
    scene = cloud_at(means, sh=rng.normal(size=(len(means), 1, 3)))
    (folder / "scene.ply").write_bytes(written(write_gaussian_ply, scene))
    write_photos(folder, scene, [PhotoCamera(photo="a.jpg", camera=CAMERA, width=160, height=120)])
    report = {"scale": "unknown", "radius_m": 2.0, "num_photos": 1, "held_out": ["a.jpg"], "warnings": []}
    (folder / "report.json").write_text(json.dumps(report | {"mesh_by": "stereo"}))


def write_photos(folder: Path, scene: GaussianCloud, cameras: list[PhotoCamera]) -> None:
    """`cameras.json`, previews that show the scene exactly, and a report picture of nothing."""
    pictures = [
        render_on_cpu(scene, one.camera, width=one.width, height=one.height).over((0.0, 0.0, 0.0)) for one in cameras
    ]
    views = [
        View(source=one.photo, image=picture, camera=one.camera) for one, picture in zip(cameras, pictures, strict=True)
    ]
    write_cameras(cameras, folder, scale="unknown")
    write_photo_previews(views, folder, needed=[view.source for view in views])
    (folder / "report.png").write_bytes(b"picture")
