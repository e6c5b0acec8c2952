"""Input of every product writer: a tree, its motion and the frames to write."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from jaxtyping import Complex64, Float32, Float64

from dynamictree.devoxelize.inextensible import InextensiblePose, TreesPose
from dynamictree.gaussian.binding import Binding
from dynamictree.mesh import TriangleMesh
from dynamictree.modal.turbulence import iter_turbulent_motion, turbulent_wind
from dynamictree.requests import ExportParams
from dynamictree.skin import Skin, SkinSummary
from dynamictree.spectrum import SparseVoxelSpectrum, iter_motion

Report = Callable[[float], None]
"""Gets the share done in [0, 1]; what it raises passes through."""
Facts = dict[str, int | float]
"""How far a product is from the motion. Empty where it is exact."""


def frame_phases(params: ExportParams, period_s: float) -> Float64[np.ndarray, " M"]:
    """Phase in the loop of every frame to write, in periods.

    Raises:
        InputError: `loop` is set and the frames are not a whole number of periods, or there are too many.
    """
    return (params.first_frame + np.arange(params.count_frames(period_s))) / params.period_frames(period_s)


@dataclass(frozen=True, kw_only=True)
class MovingTree:
    """A mesh with the spectrum of its vertices; and the splat that it carries, where a product needs one."""

    mesh: TriangleMesh
    spectrum: SparseVoxelSpectrum  # of the voxels
    coefficients: Complex64[np.ndarray, "N K 3"]  # of the vertices [m]
    loop: Complex64[np.ndarray, "N L 3"]  # the same with the frequencies that a sum of them needs not to stretch
    params: ExportParams
    pose: InextensiblePose | TreesPose | None = None  # makes each frame bend where it would stretch
    binding: Binding | None = None
    captured: bool = False  # whether pictures show the splat of the binding, or the mesh
    stride: int = 1  # of every so many frames one is written
    fits: dict[int, tuple[Skin, SkinSummary]] = field(default_factory=dict)  # cache, by the number of joints

    @cached_property
    def phases(self) -> Float64[np.ndarray, " M"]:
        """Phases of the frames to write, in periods."""
        return frame_phases(self.params, self.spectrum.period_s)[:: self.stride]

    @property
    def loop_fps(self) -> float:
        """Frames of the spectrum per second of the file's time."""
        return self.spectrum.fps * self.params.speed

    def frames(self, report: Report) -> Iterator[Float32[np.ndarray, "N 3"]]:
        """Displacement of the vertices, frame by frame [m]."""
        frames = self._motion() if self.pose is None else self.pose.iter_poses(self._motion())
        for done, frame in enumerate(frames):
            report(done / len(self.phases))
            yield frame

    def _motion(self) -> Iterator[Float32[np.ndarray, "N 3"]]:
        num_frames = self.spectrum.num_frames
        if self.params.wind_mode == "loop":
            return iter_motion(self.coefficients, self.phases, num_frames)
        wind = turbulent_wind(self.spectrum, seed=self.spectrum.seed)
        return iter_turbulent_motion(self.coefficients, wind, self.phases * self.spectrum.period_s, num_frames)
