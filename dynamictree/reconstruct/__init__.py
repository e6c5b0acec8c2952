"""Reconstruction from photos: cameras, a splat and a mesh, on the CPU."""

from dynamictree.reconstruct.options import ReconstructOptions
from dynamictree.reconstruct.progress import Progress
from dynamictree.reconstruct.reconstruction import Callbacks, reconstruct
from dynamictree.reconstruct.result import Reconstruction, Report

__all__ = ["Callbacks", "Progress", "ReconstructOptions", "Reconstruction", "Report", "reconstruct"]
