"""Gaussian clouds in memory: metres, +Z up, quaternions wxyz, linear scales, opacity in [0, 1]."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float32, Float64, Int

from dynamictree.errors import InputError
from dynamictree.source import METRES_Z_UP, Source

MAX_GAUSSIANS = 5_000_000
"""Limit for a worker with 8 GB; a cloud of 5 million Gaussians with SH degree 3 takes 1.2 GB."""
MAX_SEQUENCE_BYTES = 64 * 1024**3
"""Limit for an archive of a cloud's motion; a lower degree, fewer Gaussians or frames reduce it."""
SH_DEGREES = {1: 0, 4: 1, 9: 2, 16: 3}  # degree by number of harmonics H = (degree + 1)²


@dataclass(frozen=True, kw_only=True)
class GaussianCloud:
    """Anisotropic Gaussians with view-dependent colour, in the order of the source.

    The colour is 0.5 + Σ_h sh_h Y_h(direction from the eye), in display space (sRGB), as in Kerbl et al. 2023.
    """

    means: Float32[np.ndarray, "G 3"]  # [m]
    quaternions: Float32[np.ndarray, "G 4"]  # unit, wxyz; rotation from the Gaussian's own axes to the world's
    scales: Float32[np.ndarray, "G 3"]  # standard deviations along its own axes [m]
    opacity: Float32[np.ndarray, " G"]
    sh: Float32[np.ndarray, "G H 3"]
    source: Source = METRES_Z_UP
    dropped: int = 0  # number of the source's rows that are not finite or marked as noise

    @property
    def num_gaussians(self) -> int:
        """Number of Gaussians G."""
        return len(self.means)

    @property
    def sh_degree(self) -> int:
        """Degree of the harmonics, 0 to 3."""
        return SH_DEGREES[self.sh.shape[1]]

    def with_sh_degree(self, degree: int) -> "GaussianCloud":
        """Drop the harmonics above a degree; a cloud of a lower degree is unchanged."""
        return replace(self, sh=np.ascontiguousarray(self.sh[:, : (degree + 1) ** 2]))

    def subset(self, rows: Int[np.ndarray, " M"] | Bool[np.ndarray, " G"]) -> "GaussianCloud":
        """Select some Gaussians, by index or by mask."""
        return replace(
            self,
            means=self.means[rows],
            quaternions=self.quaternions[rows],
            scales=self.scales[rows],
            opacity=self.opacity[rows],
            sh=self.sh[rows],
        )


def join_clouds(clouds: Sequence[GaussianCloud]) -> GaussianCloud:
    """Concatenate several clouds, with the highest degree among them."""
    width = max(cloud.sh.shape[1] for cloud in clouds)
    widened = [np.pad(cloud.sh, ((0, 0), (0, width - cloud.sh.shape[1]), (0, 0))) for cloud in clouds]
    return replace(
        clouds[0],
        means=np.concatenate([cloud.means for cloud in clouds]),
        quaternions=np.concatenate([cloud.quaternions for cloud in clouds]),
        scales=np.concatenate([cloud.scales for cloud in clouds]),
        opacity=np.concatenate([cloud.opacity for cloud in clouds]),
        sh=np.concatenate(widened),
    )


def check_count(num_gaussians: int) -> None:
    """Check a number of Gaussians before memory is allocated for them.

    Raises:
        InputError: there are none, or more than `MAX_GAUSSIANS`.
    """
    if num_gaussians == 0:
        raise InputError("the cloud is empty; at least one Gaussian or point is needed")
    if num_gaussians > MAX_GAUSSIANS:
        raise InputError(
            f"the cloud has {num_gaussians:,} Gaussians; at most {MAX_GAUSSIANS:,} are allowed; prune it first"
        )


def validate_cloud(cloud: GaussianCloud) -> GaussianCloud:
    """Return the cloud if the method can work on it.

    Raises:
        InputError: the cloud is empty, too large or invisible, has values that are not finite, or an incomplete degree.
    """
    # Threshold of 3DGS renderers, which draw nothing below it (Kerbl et al. 2023, appendix C).
    min_opacity = 1 / 255
    check_count(cloud.num_gaussians)
    if cloud.sh.shape[1] not in SH_DEGREES:
        raise InputError(f"a Gaussian has {cloud.sh.shape[1]} harmonics; 1, 4, 9 or 16 are allowed (SH degree 0 to 3)")
    for name in ("means", "quaternions", "scales", "opacity", "sh"):
        values = getattr(cloud, name).reshape(cloud.num_gaussians, -1)
        finite = np.isfinite(values).all(axis=1)
        if not finite.all():
            bad, first = int((~finite).sum()), int(np.argmin(finite))
            raise InputError(f"{name} of {bad} Gaussians are not finite, the first is Gaussian {first}; remove them")
    if cloud.scales.min() < 0:
        raise InputError(f"the smallest scale is {cloud.scales.min():.3g} m; scales must not be negative")
    if cloud.opacity.max() < min_opacity:
        raise InputError(
            f"the largest opacity is {cloud.opacity.max():.3g}, so nothing is visible; at least one must reach 1/255"
        )
    return cloud


def in_box(
    points: Float32[np.ndarray, "P 3"],
    box: tuple[tuple[float, float, float], tuple[float, float, float]],
    option: str = "box_m",
) -> Bool[np.ndarray, " P"]:
    """Return a mask of the points in a request's box [m], such as a tree without ground and pot.

    Raises:
        InputError: the box is empty, or nothing is in it; the message names `option`.
    """
    low, high = np.asarray(box[0]), np.asarray(box[1])
    if not (low < high).all():
        raise InputError(
            f"{option} runs from {box[0]} to {box[1]}; its low corner must be below its high one in x, y and z"
        )
    inside = np.asarray(((points >= low) & (points <= high)).all(axis=1))
    if not inside.any():
        bounds = points.min(axis=0).round(3).tolist(), points.max(axis=0).round(3).tolist()
        raise InputError(
            f"nothing is in {option} from {box[0]} to {box[1]}; the source is from {bounds[0]} to {bounds[1]}"
        )
    return inside


def level_of_detail(cloud: GaussianCloud, share: float) -> tuple[GaussianCloud, Int[np.ndarray, " M"]]:
    """Return a level of detail and its ascending rows: about `share` of the Gaussians, which look alike from afar.

    A Gaussian remains with a probability in proportion to its visible area (opacity times area), and is enlarged by
    the inverse of its probability, so that the covered area stays about the same everywhere.

    Raises:
        InputError: the share is not in (0, 1].
    """
    if not 0 < share <= 1:
        raise InputError(f"the level of detail is {share:g}; it is a share of the Gaussians, above 0 and at most 1")
    if share == 1:
        return cloud, np.arange(cloud.num_gaussians)
    chances = _probabilities(cloud, share)
    taken = np.floor(np.cumsum(chances) + 0.5)  # systematic sampling (Madow 1949), exact count
    rows = np.flatnonzero(np.diff(taken, prepend=0.0) > 0)
    subset, growth = cloud.subset(rows), 1 / np.sqrt(chances[rows])
    return replace(subset, scales=subset.scales * growth[:, None].astype(np.float32)), rows


def level_count(num_gaussians: int, share: float) -> int:
    """Return the number of Gaussians in a level of detail."""
    return max(1, round(num_gaussians * share))


def _probabilities(cloud: GaussianCloud, share: float) -> Float64[np.ndarray, " G"]:
    """Compute each Gaussian's probability to remain, at most 1; they sum to the number that remains."""
    count = level_count(cloud.num_gaussians, share)
    visible = np.maximum((area_m2(cloud) * cloud.opacity).astype(np.float64), 1e-30)
    ascending = np.sort(visible)
    sums = np.cumsum(ascending)
    certain = np.arange(len(visible))[::-1]  # number of larger ones that certainly remain
    unit = sums / np.maximum(count - certain, 1e-9)  # unit for which the probabilities sum to the count
    fits = (certain < count) & (ascending <= unit * (1 + 1e-12))
    chances: Float64[np.ndarray, " G"] = np.minimum(visible / unit[np.flatnonzero(fits)[-1]], 1.0)
    return chances


def area_m2(cloud: GaussianCloud) -> Float32[np.ndarray, " G"]:
    """Compute the product of the two larger scales: a Gaussian's area up to a constant [m²]."""
    ordered = np.sort(cloud.scales, axis=1)
    result: Float32[np.ndarray, " G"] = ordered[:, 1] * ordered[:, 2]
    return result
