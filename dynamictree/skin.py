"""Linear blend skinning: a motion as rigid joints, four of which carry each vertex."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32, Int32

JOINTS_PER_VERTEX = 4  # glTF 2.0, section 3.7.3.3: the number that every engine supports


@dataclass(frozen=True, kw_only=True)
class Skin:
    """Rigid motion of B joints over T frames: x' = Σ_j weights_j (rotation_j x + translation_j)."""

    parent: Int32[np.ndarray, " B"]  # -1 at the root; parents come before children
    joint_m: Float32[np.ndarray, "B 3"]  # where a joint is at rest
    rows: Int32[np.ndarray, "N 4"]
    weights: Float32[np.ndarray, "N 4"]  # sum to 1
    rotation: Float32[np.ndarray, "T B 3 3"]
    translation_m: Float32[np.ndarray, "T B 3"]

    def displacement(self, vertices: Float32[np.ndarray, "N 3"], frame: int) -> Float32[np.ndarray, "N 3"]:
        """Where the joints carry the vertices of rest, less where they were [m]."""
        moved = np.zeros_like(vertices)
        for rows, weights in zip(self.rows.T, self.weights.T, strict=True):
            turned = np.einsum("nij,nj->ni", self.rotation[frame, rows], vertices) + self.translation_m[frame, rows]
            moved += weights[:, None] * turned
        return np.asarray(moved - vertices)


@dataclass(frozen=True, kw_only=True)
class SkinSummary:
    """What was written, and how far it is from the motion."""

    num_joints: int
    num_keys: int
    relative_error: float  # root mean square of what is missing over that of the motion
    rms_error_m: float  # over all vertices and frames
    max_error_m: float  # of any vertex at any frame
