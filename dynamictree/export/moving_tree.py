"""Input of every product writer: a tree, its motion and the frames to write."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Complex64, Float32, Float64

from dynamictree.gaussian.animate import NO_FLUTTER, LeafTurns
from dynamictree.gaussian.binding import Binding
from dynamictree.mesh import TriangleMesh
from dynamictree.modal.turbulence import TurbulentWind, iter_turbulent_sums, turbulent_wind
from dynamictree.requests import ExportParams
from dynamictree.rig.flutter import Flutter, flutter_of, fluttering
from dynamictree.rig.rig import Rig
from dynamictree.rig.skin import skin_of
from dynamictree.skin import Skin, SkinSummary
from dynamictree.spectrum import SparseVoxelSpectrum

Report = Callable[[float], None]
"""Receives the completed share in [0, 1]; its exceptions propagate."""

Facts = dict[str, int | float]
"""Error of a product against the motion; empty if it is exact."""


def iter_turbulent_turns(
    rig: Rig, wind: TurbulentWind, times_s: Float64[np.ndarray, " T"], flutter: Flutter
) -> Iterator[Float32[np.ndarray, "B 3"]]:
    """Yield the turns of the bones in turbulent wind at each time [rad]; gusts make leaves flutter more."""
    leaves = flutter.theta(times_s / flutter.period_s, rig.num_frames, wind.speeds_m_s(times_s))
    for (theta, turn), more in zip(iter_turbulent_sums(rig.turns, wind, times_s, rig.num_frames), leaves, strict=True):
        yield rig.in_wind(theta, turn) + more


@dataclass(frozen=True, kw_only=True)
class MovingTree:
    """A mesh with the bones that move it, and a splat bound to it if a product needs one."""

    mesh: TriangleMesh
    spectrum: SparseVoxelSpectrum  # motion of the voxels
    rig: Rig
    params: ExportParams
    binding: Binding | None = None
    captured: bool = False  # whether pictures show the splat of the binding, or the mesh
    leaves: Flutter | None = None  # flutter of the binding's leaves

    @cached_property
    def phases(self) -> Float64[np.ndarray, " M"]:
        """Phases of the frames to write [periods]."""
        frames = np.arange(self.params.count_frames(self.spectrum.period_s))
        return (self.params.first_frame + frames) / self.params.period_frames(self.spectrum.period_s)

    @property
    def loop_fps(self) -> float:
        """Frames of the spectrum per second of the file's time."""
        return self.spectrum.fps * self.params.speed

    @cached_property
    def coefficients(self) -> Complex64[np.ndarray, "N K 3"]:
        """The vertices' loop with K frequencies [m]."""
        return self.rig.loop(self.mesh.vertices, self.rig.vertices)

    @cached_property
    def loop(self) -> Complex64[np.ndarray, "N L 3"]:
        """The vertices' loop with K, 2 K or all frequencies, the fewest that lose little [m]."""
        sampled_vertices = 10_000  # vertices that decide on the number of frequencies
        # share of the height: largest motion of a vertex above the chosen frequencies, 1 mm at 10 m
        most_lost = 1e-4
        vertices, weights = self.mesh.vertices, self.rig.vertices
        some = slice(None, None, -(-len(vertices) // sampled_vertices))
        fewest, most = self.spectrum.num_frequencies, self.spectrum.num_frames // 2 + 1
        size = 2 * np.linalg.norm(self.rig.loop(vertices[some], weights[some], most), axis=2)  # [n, most]
        lost = [size[:, enough:].sum(axis=1).max() for enough in (fewest, 2 * fewest)]
        if lost[0] <= most_lost * self.mesh.height_m:
            return self.coefficients
        enough = 2 * fewest if lost[1] <= most_lost * self.mesh.height_m else most
        return self.rig.loop(vertices, weights, min(enough, most))

    def loop_frames(self) -> Iterator[Float32[np.ndarray, "N 3"]]:
        """Yield the displacement of the vertices at each frame of the loop, with flutter of leaves [m]."""
        phases = np.arange(self.spectrum.num_frames) / self.spectrum.num_frames
        for theta in self.fluttering.theta(phases):
            yield self.rig.displacement(theta, self.mesh.vertices, self.rig.vertices)

    @cached_property
    def fluttering(self) -> Rig:
        """The rig with flutter of leaves above the spectrum's frequencies, which morph targets lack."""
        return fluttering(self.rig, self.spectrum, self.params.flutter)

    @cached_property
    def skin(self) -> tuple[Skin, SkinSummary]:
        """All bones as joints, or only the few that lose the least motion, and their error against the rig."""
        return skin_of(self.fluttering, self.mesh.vertices, self.params.joints or len(self.rig.skeleton))

    def frames(self, report: Report) -> Iterator[Float32[np.ndarray, "N 3"]]:
        """Yield the displacement of the vertices, frame by frame, with flutter of leaves [m]."""
        for done, theta in enumerate(self._turns()):
            report(done / len(self.phases))
            yield self.rig.displacement(theta, self.mesh.vertices, self.rig.vertices)

    def leaf_turns(self) -> LeafTurns:
        """Yield the rotation of each leaf of the binding, frame by frame [rad]."""
        if self.leaves is None:
            return NO_FLUTTER
        times_s, in_loop = self.phases * self.spectrum.period_s, self.params.wind_mode == "loop"
        speeds_m_s = None if in_loop else self._turbulence.speeds_m_s(times_s)
        return self.leaves.theta(self.phases, self.spectrum.num_frames, speeds_m_s)

    @cached_property
    def _turbulence(self) -> TurbulentWind:
        return turbulent_wind(self.spectrum, seed=self.spectrum.seed)

    def _turns(self) -> Iterator[Float32[np.ndarray, "B 3"]]:
        if self.params.wind_mode == "loop":
            yield from self.fluttering.theta(self.phases)
            return
        yield from iter_turbulent_turns(
            self.rig,
            self._turbulence,
            self.phases * self.spectrum.period_s,
            flutter_of(self.rig, self.spectrum, self.params.flutter),
        )
