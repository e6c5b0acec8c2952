"""The motion of a mesh's vertices, which does not depend on the products: computed once per spectrum and mesh."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Complex64

from dynamictree.devoxelize.inextensible import (
    LARGEST_STRETCH,
    InextensiblePose,
    TreesPose,
    pose_of,
    typical_stretch,
    without_stretch,
)
from dynamictree.devoxelize.length_preserving import (
    LengthPreservingInterpolation,
    OnProgress,
    TreesInterpolation,
    length_preserving,
)
from dynamictree.formats.tensors.vertex_motion import VertexMotion, read_vertex_motion, write_vertex_motion
from dynamictree.formats.tensors.vertex_ties import read_ties, write_ties
from dynamictree.mesh import TriangleMesh
from dynamictree.spectrum import SparseVoxelSpectrum

FRAMES_A_FREQUENCY = 3
"""From so many frames the loop without stretch is read; two would do, were there nothing above its frequencies."""
LARGEST_LOOP_STRETCH = 0.02
"""99th percentile of the edges' stretch in such a loop; one with more gets frequencies above K."""
MAX_STORED_BYTES = 1 << 28
"""Larger results are computed again: reading them would take as long. Loops get no more frequencies than fit."""
_TIES_SHARE, _LINEAR_SHARE = 0.2, 0.5  # of the time of all, about

Result = Literal["ties", "motion", "reconstruction"]
"""What ties vertices to voxels, the same for all seeds and winds; the vertices' motion; and what photos show."""
Recall = Callable[[Result, Callable[[Path], None]], Path]
"""Gives the file of a result; where there is none, calls the function that writes it to a path."""


@dataclass(frozen=True, kw_only=True)
class MotionSource:
    """Where the motion of one mesh and spectrum comes from: from stored results, as far as they are there."""

    mesh: TriangleMesh
    spectrum: SparseVoxelSpectrum
    recall: Recall | None = None
    ties: LengthPreservingInterpolation | None = None  # where they are in memory already

    def motion(self, on_progress: OnProgress) -> VertexMotion:
        """Spectrum of the vertices [m]; `on_progress` gets the share done, and what it raises passes through."""
        if self.recall is None or self._largest_stored < 2 * self.spectrum.num_frequencies:
            return self._computed(on_progress)

        def make(path: Path) -> None:
            with path.open("xb") as stream:
                write_vertex_motion(self._computed(on_progress), stream)

        with self.recall("motion", make).open("rb") as stream:
            return read_vertex_motion(stream)

    def pose(self, motion: VertexMotion) -> InextensiblePose | TreesPose:
        """What makes each frame of this motion bend where it would stretch."""
        return self._pose_of(motion.linear)

    def _computed(self, on_progress: OnProgress) -> VertexMotion:
        on_progress(0.0)
        ties = self._ties
        on_progress(_TIES_SHARE)
        linear = ties.apply(
            self.spectrum.coefficients, lambda done: on_progress(_TIES_SHARE + done * (_LINEAR_SHARE - _TIES_SHARE))
        )
        on_progress(_LINEAR_SHARE)
        if typical_stretch(ties, linear) <= LARGEST_STRETCH:
            return VertexMotion(linear=linear)
        fewest = self.spectrum.num_frequencies
        most = max(fewest, min(self.spectrum.num_frames // 2, self._largest_stored - fewest))
        loop = without_stretch(
            self._pose_of(linear),
            linear,
            self.spectrum.num_frames if most > fewest else FRAMES_A_FREQUENCY * fewest,
            lambda done: on_progress(_LINEAR_SHARE + done * (1 - _LINEAR_SHARE)),
            num_frequencies=most,
        )
        for enough in (fewest, 2 * fewest):
            if enough < most and typical_stretch(ties, loop[:, :enough]) <= LARGEST_LOOP_STRETCH:
                return VertexMotion(linear=linear, bent=np.ascontiguousarray(loop[:, :enough]))
        return VertexMotion(linear=linear, bent=loop)

    @property
    def _largest_stored(self) -> int:
        """How many frequencies of all vertices are stored at most."""
        return MAX_STORED_BYTES // (3 * np.dtype(np.complex64).itemsize * max(self.mesh.num_vertices, 1))

    def _pose_of(self, linear: Complex64[np.ndarray, "N K 3"]) -> InextensiblePose | TreesPose:
        """The pose of a motion; the last one is reused, as its factors take as long as many frames."""
        if not self._last_pose or self._last_pose[0][0] is not linear:
            self._last_pose[:] = [(linear, pose_of(self._ties, linear))]
        return self._last_pose[0][1]

    @cached_property
    def _last_pose(self) -> list[tuple[Complex64[np.ndarray, "N K 3"], InextensiblePose | TreesPose]]:
        return []

    @cached_property
    def _ties(self) -> LengthPreservingInterpolation | TreesInterpolation:
        if self.ties is not None:
            return self.ties
        if self.recall is None or self.mesh.face_tree is not None:
            return length_preserving(self.spectrum.grid, self.mesh)

        def make(path: Path) -> None:
            ties = length_preserving(self.spectrum.grid, self.mesh)
            assert isinstance(ties, LengthPreservingInterpolation)
            with path.open("xb") as stream:
                write_ties(ties.interpolation, stream)

        with self.recall("ties", make).open("rb") as stream:
            ties = read_ties(stream)
        return LengthPreservingInterpolation(mesh=self.mesh, grid=self.spectrum.grid, interpolation=ties)


def vertex_motion(
    mesh: TriangleMesh,
    spectrum: SparseVoxelSpectrum,
    *,
    every_frame: bool = False,
    recall: Recall | None = None,
    on_progress: OnProgress,
) -> tuple[VertexMotion, InextensiblePose | TreesPose | None]:
    """Motion of the vertices, and what preserves lengths in each frame where it is large.

    `every_frame` asks for the latter whatever the size of the motion.
    """
    source = MotionSource(mesh=mesh, spectrum=spectrum, recall=recall)
    motion = source.motion(on_progress)
    return motion, source.pose(motion) if every_frame or motion.bent is not None else None
