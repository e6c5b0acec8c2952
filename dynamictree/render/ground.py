"""Backdrop for pictures of splats: sky, level floor and a shadow on it."""

import numpy as np
from jaxtyping import Float, Float32, Float64
from scipy.ndimage import gaussian_filter, map_coordinates

from dynamictree.render.camera import Camera

# display colours of floor and sky in pictures of meshes
_FLOOR = np.array([0.86, 0.86, 0.845], np.float32)
_HORIZON = np.array([0.906, 0.924, 0.945], np.float32)
_ZENITH = np.array([0.634, 0.755, 0.895], np.float32)
_CELLS = 160  # number along each side of the shadow map
_REACH = 2.2  # half side of the shadow map [radii]
_SUN = np.array([-0.40, -0.45, 0.95])  # direction towards the sun, as `Look.sun_direction`


class Backdrop:
    """Sky and floor for one camera, prepared once, with a moving shadow."""

    def __init__(
        self,
        camera: Camera,
        *,
        size_px: tuple[int, int],
        ground_m: float,
        centre_m: Float[np.ndarray, "2"],
        radius_m: float,
    ) -> None:
        """Prepare the view of a level floor; lengths are in metres, the picture's width and height in pixels."""
        fade = 3.0  # [radii] from the middle over which the floor blends into the horizon
        width, height = size_px
        place = np.stack(np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5), axis=-1).reshape(-1, 2)  # [P, 2]
        rays = np.concatenate([place, np.ones((len(place), 1))], axis=1)
        rays = rays @ np.linalg.inv(camera.intrinsics_px(width, height)).T @ camera.world_to_camera
        rays /= np.linalg.norm(rays, axis=1, keepdims=True)
        up = np.clip(rays[:, 2:], 0, 1)
        share = 1 - np.exp(-4 * up)
        picture = _HORIZON + share * (_ZENITH - _HORIZON)
        drop = camera.position_m[2] - ground_m
        hit = (rays[:, 2] < -1e-6) & (drop > 0)
        ground = camera.position_m[:2] + rays[hit, :2] * (drop / -rays[hit, 2:])
        away = np.linalg.norm(ground - centre_m, axis=1, keepdims=True) / (fade * radius_m)
        picture[hit] = _FLOOR + (1 - np.exp(-(away**2))) * (_HORIZON - _FLOOR)
        self._picture = picture.astype(np.float32).reshape(height, width, 3)
        self._hit = hit
        self._low_m = np.asarray(centre_m, np.float64) - _REACH * radius_m
        self._cell_m = 2 * _REACH * radius_m / _CELLS
        self._cells = ((ground - self._low_m) / self._cell_m - 0.5).T  # [2, hits]
        self._ground_m = ground_m

    def picture(
        self, points: Float32[np.ndarray, "G 3"] | None = None, covered_m2: Float32[np.ndarray, " G"] | None = None
    ) -> Float32[np.ndarray, "H W 3"]:
        """Draw sky and floor, with the shadow of points that each cover an area."""
        thickness = 0.7  # optical depth per covered area
        darkest = 0.5
        picture: Float32[np.ndarray, "H W 3"] = self._picture.copy()
        if points is None or covered_m2 is None or not self._hit.any():
            return picture
        light = 1 - darkest * (1 - np.exp(-thickness * self.shadow(points, covered_m2)))
        seen = map_coordinates(light, self._cells, order=1, mode="constant", cval=1.0)
        flat = picture.reshape(-1, 3)
        flat[self._hit] *= seen[:, None].astype(np.float32)
        return picture

    def shadow(
        self, points: Float32[np.ndarray, "G 3"], covered_m2: Float32[np.ndarray, " G"]
    ) -> Float64[np.ndarray, "X Y"]:
        """Compute how many times each cell of the floor is covered, seen from the sun."""
        blur_cells = 1.2
        along = (points[:, 2:] - self._ground_m) / _SUN[2]
        cell = np.floor((points[:, :2] - along * _SUN[:2] - self._low_m) / self._cell_m).astype(np.int64)
        inside = ((cell >= 0) & (cell < _CELLS)).all(axis=1) & (along[:, 0] >= 0)
        index = cell[inside, 0] * _CELLS + cell[inside, 1]
        covered = np.bincount(index, covered_m2[inside], minlength=_CELLS**2) / self._cell_m**2
        blurred: Float64[np.ndarray, "X Y"] = gaussian_filter(covered.reshape(_CELLS, _CELLS), blur_cells)
        return blurred
