"""Photos of a tree on a lawn with a hedge around it, under clouds, in light that changes between photos."""

from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float32, Float64, UInt8
from PIL import Image
from scipy.ndimage import gaussian_filter, map_coordinates

from benchmarks._photo_set import fine_renderer, render_cut_out, solid_noise, with_speckles
from dynamictree.mesh import TriangleMesh
from dynamictree.render import Camera
from lab.dataset.sample import make_sample

Color = tuple[float, float, float]
_EYES_M = 1.6
_CELLS = 4096  # cells along the lawn, and around the hedge, so that no texture repeats
_CLOUD_CELLS = 256, 1024  # cells in elevation and azimuth
_GRAINS = 0.8, 2.5, 8.0, 25.0, 80.0  # sizes of grain [cells]
_HEDGE_RADIUS, _HEDGE_HEIGHT = 4.0, 0.35  # [share of the tree's height]
_GRASS, _SOIL, _HEDGE, _SHADE = (0.50, 0.68, 0.28), (0.18, 0.15, 0.07), (0.36, 0.50, 0.22), (0.05, 0.10, 0.04)
_HORIZON, _ZENITH, _CLOUD = (0.80, 0.87, 0.93), (0.30, 0.50, 0.80), (0.97, 0.97, 0.98)


def photograph_on_lawn(
    folder: Path, *, number: int, side: int, species: str = "round-broadleaf", height_m: float = 3.5, seed: int = 7
) -> dict[str, UInt8[np.ndarray, "H W"]]:
    """Write JPEG photos of a walk around the tree; return, by name, each pixel's coverage by the tree."""
    grown = with_speckles(make_sample(seed, species).mesh)
    tree = grown.with_vertices((grown.vertices * (height_m / grown.height_m)).astype(np.float32))
    renderer, garden = fine_renderer(tree, side), _Garden(tree)
    rng = np.random.default_rng(4)
    bark = solid_noise(rng)
    masks = {}
    for place, camera in enumerate(_walk(tree, number)):
        behind = 255 * garden.seen_along(_rays(camera, side), camera, side)
        rgba = render_cut_out(renderer, camera, side, bark).astype(np.float64)
        cover = rgba[..., 3:] / 255
        scene = cover * rgba[..., :3] + (1 - cover) * behind
        name = f"IMG_{place:04d}.jpg"
        photo = np.clip(np.exp(0.15 * rng.normal()) * scene, 0, 255).round().astype(np.uint8)
        Image.fromarray(photo).save(folder / name, quality=92)
        masks[name] = rgba[..., 3].astype(np.uint8)
    return masks


def _walk(tree: TriangleMesh, number: int) -> list[Camera]:
    """Return cameras at eye height, on a slightly irregular circle."""
    height, rng = tree.height_m, np.random.default_rng(5)
    middle = np.array([*tree.vertices.mean(axis=0)[:2], tree.vertices[:, 2].min() + 0.5 * height], np.float64)
    cameras = []
    for place in range(number):
        turn = 2 * np.pi * place / number
        away = 1.9 * height * (1 + 0.03 * rng.normal())
        position = [*(middle[:2] + away * np.array([np.cos(turn), np.sin(turn)])), middle[2] - 0.5 * height + _EYES_M]
        cameras.append(Camera.look_at(np.array(position), middle, vertical_fov_deg=36.0))
    return cameras


class _Garden:
    """Background of the photos. The sky is infinitely far, so it turns with the camera."""

    def __init__(self, tree: TriangleMesh) -> None:
        rng = np.random.default_rng(2)
        self.foot = np.array([*tree.vertices.mean(axis=0)[:2], tree.vertices[:, 2].min()], np.float64)
        self.hedge_radius_m, self.hedge_height_m = _HEDGE_RADIUS * tree.height_m, _HEDGE_HEIGHT * tree.height_m
        self.grain = [_layer(rng, (_CELLS, _CELLS), size, "wrap") for size in _GRAINS]
        clouds = sum(_layer(rng, _CLOUD_CELLS, size, ("nearest", "wrap")) for size in (4, 12, 36))
        self.clouds = np.clip(clouds / 3, 0, 1)

    def seen_along(self, ray: Float64[np.ndarray, "H W 3"], camera: Camera, side: int) -> Float64[np.ndarray, "H W 3"]:
        """Return the colours along rays, 0 to 1."""
        start = camera.position_m - self.foot
        color = self._sky(ray)
        # the hedge is a cylinder around the camera, the lawn a plane in front of it
        a, b = (ray[..., :2] ** 2).sum(axis=2), ray[..., :2] @ start[:2]
        to_hedge = (np.sqrt(b**2 - a * (start[:2] @ start[:2] - self.hedge_radius_m**2)) - b) / a
        place = start + to_hedge[..., None] * ray
        on_hedge = (place[..., 2] > 0) & (place[..., 2] < self.hedge_height_m)
        around_m = 2 * np.pi * self.hedge_radius_m
        along = self.hedge_radius_m * np.arctan2(place[..., 1], place[..., 0])
        pixel_m = to_hedge / (camera.focal * side)
        color[on_hedge] = self._grained(along, place[..., 2], pixel_m, around_m, _HEDGE, _SHADE)[on_hedge]
        down = np.minimum(ray[..., 2], -1e-6)
        to_lawn = -start[2] / down
        place = start + to_lawn[..., None] * ray
        on_lawn, across_m = to_lawn < to_hedge, 2 * self.hedge_radius_m
        pixel_m = to_lawn / (camera.focal * side * -down)
        color[on_lawn] = self._grained(place[..., 0], place[..., 1], pixel_m, across_m, _GRASS, _SOIL)[on_lawn]
        return color

    def _grained(
        self,
        x_m: Float64[np.ndarray, "H W"],
        y_m: Float64[np.ndarray, "H W"],
        pixel_m: Float64[np.ndarray, "H W"],
        whole_m: float,
        light: Color,
        dark: Color,
    ) -> Float64[np.ndarray, "H W 3"]:
        """Return colours of grass with grain of all sizes; grain smaller than a pixel fades out."""
        per_m = _CELLS / whole_m
        shade = np.full(x_m.shape, 0.5)
        for layer, size in zip(self.grain, _GRAINS, strict=True):
            seen = np.exp(-((per_m * pixel_m / (4 * size)) ** 2))
            shade += 0.15 * seen * map_coordinates(layer, [per_m * x_m, per_m * y_m], order=1, mode="grid-wrap")
        shade = np.clip(shade, 0, 1)[..., None]
        return shade * light + (1 - shade) * np.array(dark)

    def _sky(self, ray: Float64[np.ndarray, "H W 3"]) -> Float64[np.ndarray, "H W 3"]:
        up = np.clip(ray[..., 2], 0, 1)
        around = np.arctan2(ray[..., 1], ray[..., 0]) / (2 * np.pi) % 1
        places = [up * (_CLOUD_CELLS[0] - 1), around * _CLOUD_CELLS[1]]
        cover = map_coordinates(self.clouds, places, order=1, mode="grid-wrap")[..., None]
        pale = (1 - up[..., None]) ** 2
        blue = pale * _HORIZON + (1 - pale) * np.array(_ZENITH)
        return (1 - cover) * blue + cover * np.array(_CLOUD)


def _layer(rng: np.random.Generator, shape: tuple[int, int], size: float, mode: Any) -> Float32[np.ndarray, "A B"]:
    """Return noise of one grain size with standard deviation 1."""
    smooth = gaussian_filter(rng.normal(size=shape), size, mode=mode)
    return (smooth / smooth.std()).astype(np.float32)


def _rays(camera: Camera, side: int) -> Float64[np.ndarray, "H W 3"]:
    to_ray = camera.world_to_camera.T @ np.linalg.inv(camera.intrinsics_px(side, side))
    column, row = np.meshgrid(np.arange(side) + 0.5, np.arange(side) + 0.5)
    ray = np.stack([column, row, np.ones_like(row)], axis=2) @ to_ray.T
    return ray / np.linalg.norm(ray, axis=2, keepdims=True)
