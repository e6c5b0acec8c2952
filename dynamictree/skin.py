"""Linear blend skinning: a motion as joints that turn, with four joints per vertex."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32, Int32

JOINTS_PER_VERTEX = 4  # glTF 2.0, section 3.7.3.3: the number that every engine supports


@dataclass(frozen=True, kw_only=True)
class Skin:
    """B joints over T frames. A joint turns about its rest position, which moves with its parent."""

    parent: Int32[np.ndarray, " B"]  # -1 at the root; parents come before children
    joint_m: Float32[np.ndarray, "B 3"]  # rest positions
    rows: Int32[np.ndarray, "N 4"]
    weights: Float32[np.ndarray, "N 4"]  # multiples of 1/255 that sum to 1
    turns: Float32[np.ndarray, "T B 4"]  # quaternions wxyz in steps of 1/32767, relative to the parent


@dataclass(frozen=True, kw_only=True)
class SkinSummary:
    """Size of a written skin, and its error against the motion."""

    num_joints: int
    num_keys: int
    relative_error: float  # root mean square of the error over that of the motion
    rms_error_m: float  # over all vertices and frames
    max_error_m: float  # largest error of any vertex at any frame
