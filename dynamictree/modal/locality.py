"""How far a push reaches: the falloff of a request."""

import numpy as np

from dynamictree.modal.system import ModalSystem
from dynamictree.requests import SwingParams


def default_falloff_m(system: ModalSystem) -> float:
    """Default falloff of a push [m]."""
    falloff_share = 0.15  # of the tree's height: the default falloff
    levels = int(np.ptp(system.grid.coords[:, 2])) + 1
    return falloff_share * levels * system.grid.voxel_size_m


def chosen_falloff_m(system: ModalSystem, params: SwingParams) -> float | None:
    """Falloff of a request [m]; None where a push moves the whole tree."""
    return None if params.locality == "none" else params.falloff_m or default_falloff_m(system)
