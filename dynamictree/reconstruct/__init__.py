"""Photos to cameras and a coarse mesh, on the CPU."""

from dynamictree.reconstruct.reconstruction import Reconstruction, Report, reconstruct

__all__ = ["Reconstruction", "Report", "reconstruct"]
