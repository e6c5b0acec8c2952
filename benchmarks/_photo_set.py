"""Photos of a known tree: RGBA pictures from the project's own renderer, with their cameras."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
from PIL import Image
from scipy.ndimage import gaussian_filter, map_coordinates

from dynamictree.mesh import TriangleMesh
from dynamictree.render import Camera, Renderer, RenderSettings
from lab.dataset.sample import make_sample

SAMPLES = 3
"""Samples along a pixel's side for colour and coverage, so that edges have no sky colour."""
GRAIN_M, GRAIN = 0.01, 0.4
"""Size of the grain of bark and leaves, and its strength."""


def photograph(folder: Path, *, number: int, side: int, species: str = "round-broadleaf", seed: int = 7) -> list[Path]:
    """Write photos of an orbit around a tree with speckled bark and leaves, and `transforms.json`, to the folder."""
    tree = with_speckles(make_sample(seed, species).mesh)
    renderer = fine_renderer(tree, side)
    photos, frames = [], []
    cameras = orbit_cameras(tree, number)
    for place, camera in enumerate(cameras):
        path = folder / f"tree_{place:02d}.png"
        Image.fromarray(render_cut_out(renderer, camera, side)).save(path)
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = camera.world_to_camera.T * [1, -1, -1], camera.position_m
        frames.append({"file_path": path.name, "transform_matrix": matrix.tolist()})
        photos.append(path)
    focal = cameras[0].focal * side
    lens = {"fl_x": focal, "fl_y": focal, "cx": side / 2, "cy": side / 2, "w": side, "h": side}
    (folder / "transforms.json").write_text(json.dumps({**lens, "frames": frames}))
    return photos


def with_speckles(tree: TriangleMesh) -> TriangleMesh:
    """Return the tree brightened, with a random colour per vertex, so that it has detectable features."""
    shades = np.clip(np.random.default_rng(1).normal(0.7, 0.3, (tree.num_vertices, 3)), 0.1, 1)
    colors = np.concatenate([255 * shades, np.full((len(shades), 1), 255)], axis=1).astype(np.uint8)
    bright = tuple(
        replace(m, base_color=(*(min(1.0, 2 * c) for c in m.base_color[:3]), m.base_color[3]))
        for m in tree.look.materials
    )
    return replace(tree, look=replace(tree.look, vertex_colors=colors, materials=bright))


def orbit_cameras(tree: TriangleMesh, number: int) -> tuple[Camera, ...]:
    """Return cameras around a tree, alternately lower and higher."""
    height = tree.height_m
    middle = np.array([*tree.vertices.mean(axis=0)[:2], 0.5 * height], np.float64)
    cameras = []
    for place in range(number):
        turn = 2 * np.pi * place / number
        away = height * np.array([1.9 * np.cos(turn), 1.9 * np.sin(turn), 0.25 * (place % 2) - 0.1])
        cameras.append(Camera.look_at(middle + away, middle, vertical_fov_deg=36.0))
    return tuple(cameras)


def fine_renderer(mesh: TriangleMesh, side: int) -> Renderer:
    """Return a renderer that draws every pixel of a square photo as SAMPLES × SAMPLES pixels."""
    fine = side * SAMPLES
    return Renderer(mesh, RenderSettings(width=fine, height=fine, ground=False, supersampling=1))


def solid_noise(rng: np.random.Generator) -> np.ndarray:
    """Return a seamless block of noise with standard deviation 1; a cell is GRAIN_M wide."""
    block = gaussian_filter(rng.normal(size=(96, 96, 96)), 0.7, mode="wrap")
    return (block / block.std()).astype(np.float32)


def render_cut_out(renderer: Renderer, camera: Camera, side: int, solid: np.ndarray | None = None) -> np.ndarray:
    """Render an RGBA photo with a `fine_renderer`; `solid` adds grain to the surfaces."""
    color = renderer.picture(camera=camera).astype(np.float64)
    depth = renderer.buffers(camera).depth_m
    seen_at = np.isfinite(depth)
    if solid is not None:
        row, column = np.nonzero(seen_at)
        pixels = np.stack([column + 0.5, row + 0.5, np.ones(len(row))], axis=1)
        to_ray = camera.world_to_camera.T @ np.linalg.inv(camera.intrinsics_px(*depth.shape[::-1]))
        places = camera.position_m + depth[row, column, None] * (pixels @ to_ray.T)
        grain = map_coordinates(solid, (places / GRAIN_M).T, order=1, mode="grid-wrap")
        color[seen_at] = np.clip(color[seen_at] * (1 + GRAIN * grain[:, None]), 0, 255)
    cover = seen_at.astype(np.float64)[..., None]
    cells = (side, SAMPLES, side, SAMPLES, -1)
    alpha = cover.reshape(cells).mean(axis=(1, 3))
    seen = (color * cover).reshape(cells).mean(axis=(1, 3)) / np.maximum(alpha, 1e-9)
    return np.concatenate([seen, 255 * alpha], axis=2).round().astype(np.uint8)
