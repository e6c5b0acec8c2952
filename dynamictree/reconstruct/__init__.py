"""Photos to cameras, a splat and a mesh, on the CPU."""

from dynamictree.reconstruct.reconstruction import Reconstruction, ReconstructOptions, reconstruct
from dynamictree.reconstruct.report import Report

__all__ = ["ReconstructOptions", "Reconstruction", "Report", "reconstruct"]
