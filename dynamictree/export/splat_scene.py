"""Scene of a bound splat over a floor, for films and previews of splats."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float32, UInt8

from dynamictree.color import STILL_SHARE, greyed, linear_to_srgb
from dynamictree.gaussian.animate import reduced_splat
from dynamictree.gaussian.binding import Binding
from dynamictree.gaussian.cloud import GaussianCloud, area_m2
from dynamictree.gaussian.deform import Pose
from dynamictree.gaussian.harmonics import SH_0
from dynamictree.gaussian.rasterize import render_cloud
from dynamictree.render import Backdrop
from dynamictree.render.camera import Camera, points_in_view


@dataclass(frozen=True, kw_only=True)
class SplatScene:
    """A bound splat over a floor, ready to be drawn."""

    binding: Binding
    bounds: Float32[np.ndarray, "M 3"]  # points that a picture must contain [m]
    covered_m2: Float32[np.ndarray, " moving"]  # area that each moving Gaussian shades
    ground: bool  # whether there is a floor

    @classmethod
    def of(cls, binding: Binding, *, ground: bool, grey_still: bool = False) -> "SplatScene":
        """Prepare a scene: large clouds at a lower level of detail, still parts in grey if `grey_still` is set."""
        # a larger cloud is drawn at a lower level of detail: 0.2 s per picture on two cores
        preview_gaussians = 200_000
        binding = reduced_splat(binding, share=min(1.0, preview_gaussians / binding.cloud.num_gaussians))
        if grey_still:
            binding = replace(binding, cloud=_grey_where(binding.cloud, ~binding.moving))
        cloud = binding.cloud
        covered = (np.pi * area_m2(cloud) * cloud.opacity)[binding.moving]
        bounds = _bounding_points(cloud.subset(points_in_view(cloud.means, binding.moving)))
        return cls(binding=binding, bounds=bounds, covered_m2=covered, ground=ground)

    def backdrop(self, camera: Camera, size_px: tuple[int, int]) -> Backdrop:
        """Return the sky and floor behind the splat, for one camera."""
        strays = 0.001  # share of the Gaussians, the lowest, that may lie below the floor
        floor = float(np.quantile(self.bounds[:, 2], strays)) if self.ground else -np.inf
        low, high = self.bounds.min(axis=0), self.bounds.max(axis=0)
        centre, radius = (low[:2] + high[:2]) / np.float32(2), max(float(np.linalg.norm(high - low)) / 2, 1e-6)
        return Backdrop(camera, size_px=size_px, ground_m=floor, centre_m=centre, radius_m=radius)

    def picture(
        self, camera: Camera, size_px: tuple[int, int], pose: Pose, backdrop: Backdrop, *, shadow: bool = True
    ) -> UInt8[np.ndarray, "H W 3"]:
        """Draw one picture of a pose."""
        moving = self.binding.moving
        behind = backdrop.picture(pose.means[moving], self.covered_m2) if shadow and self.ground else backdrop.picture()
        width, height = size_px
        return render_cloud(self.binding.cloud, camera, width=width, height=height, pose=pose).over(behind)


def _grey_where(cloud: GaussianCloud, still: Bool[np.ndarray, " G"]) -> GaussianCloud:
    """Turn still Gaussians grey, and darken them to `STILL_SHARE`; 0.5 + Σ sh Y is a display value."""
    share = linear_to_srgb(np.array([STILL_SHARE], np.float32))
    sh = cloud.sh.copy()
    sh[still] = share * greyed(sh[still])
    sh[still, 0] -= (1 - share) * 0.5 / np.float32(SH_0)
    return replace(cloud, sh=sh)


def _bounding_points(cloud: GaussianCloud) -> Float32[np.ndarray, "M 3"]:
    """Return points that a picture must contain: the centres of the Gaussians, extended by their scales [m]."""
    most = 0.95  # quantile that limits the scales; a few Gaussians may be as large as the scene
    sigma = cloud.scales.max(axis=1, keepdims=True)
    reach = np.minimum(sigma, np.quantile(sigma, most).astype(np.float32))
    return np.concatenate([cloud.means - reach, cloud.means + reach])
