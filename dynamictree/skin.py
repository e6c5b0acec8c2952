"""Linear blend skinning: a motion as joints that turn, four of which carry each vertex."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32, Int32

JOINTS_PER_VERTEX = 4  # glTF 2.0, section 3.7.3.3: the number that every engine supports


@dataclass(frozen=True, kw_only=True)
class Skin:
    """B joints over T frames. A joint turns about its place at rest, which its parent carries."""

    parent: Int32[np.ndarray, " B"]  # -1 at the root; parents come before children
    joint_m: Float32[np.ndarray, "B 3"]  # where a joint is at rest
    rows: Int32[np.ndarray, "N 4"]
    weights: Float32[np.ndarray, "N 4"]  # in steps of 1/255; sum to 1
    turns: Float32[np.ndarray, "T B 4"]  # quaternions wxyz in steps of 1/32767, as the parent sees it


@dataclass(frozen=True, kw_only=True)
class SkinSummary:
    """What was written, and how far it is from the motion."""

    num_joints: int
    num_keys: int
    relative_error: float  # root mean square of what is missing over that of the motion
    rms_error_m: float  # over all vertices and frames
    max_error_m: float  # of any vertex at any frame
