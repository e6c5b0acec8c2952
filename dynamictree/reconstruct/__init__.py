"""Reconstruction from photos: cameras, a splat and a mesh, on the CPU."""

from dynamictree.reconstruct.progress import Progress
from dynamictree.reconstruct.reconstruction import ReconstructOptions, reconstruct
from dynamictree.reconstruct.result import Reconstruction, Report

__all__ = ["Progress", "ReconstructOptions", "Reconstruction", "Report", "reconstruct"]
