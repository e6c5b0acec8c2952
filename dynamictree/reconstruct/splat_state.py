"""Checkpoints of a splat's optimisation; an interrupted run continues to the same result."""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from jaxtyping import Float32, Float64, Int64

from dynamictree.files import atomic_file


@dataclass(kw_only=True)
class SplatState:
    """Gaussians, their moments in Adam, and measurements of the run; changed in place."""

    table: Float32[np.ndarray, "G P"]  # columns as in `splat_table`
    first: Float32[np.ndarray, "G P"]  # first moments of Adam
    second: Float32[np.ndarray, "G P"]
    pull: Float32[np.ndarray, "2 G"]  # summed gradient by position and number of views, since the last densification
    step: int = 0
    num_discarded: int = 0  # Gaussians whose gradient was not finite
    checks: Float64[np.ndarray, "C 3"] = field(  # step, number of Gaussians, PSNR of the held-out photos [dB]
        default_factory=lambda: np.zeros((0, 3))
    )

    @classmethod
    def beginning(cls, table: Float32[np.ndarray, "G P"]) -> "SplatState":
        """Return the state before the first step."""
        first, second = np.zeros_like(table), np.zeros_like(table)
        return cls(table=table, first=first, second=second, pull=np.zeros((2, len(table)), np.float32))

    @classmethod
    def load(cls, path: Path) -> "SplatState":
        """Read a state that `save` wrote."""
        with np.load(path, allow_pickle=False) as arrays:
            values = {name: arrays[name] for name in arrays}
        for name in ("step", "num_discarded"):
            values[name] = values[name].item()
        return cls(**values)

    def save(self, path: Path) -> None:
        """Write the state atomically."""
        with atomic_file(path) as stream:
            np.savez(stream, **vars(self))

    @property
    def mean_pull(self) -> Float32[np.ndarray, " G"]:
        """Mean norm of the gradient by position, over the views that see a Gaussian; 0 if none does."""
        mean: Float32[np.ndarray, " G"] = self.pull[0] / np.maximum(self.pull[1], 1)
        return mean

    def keep(self, rows: Int64[np.ndarray, " M"], new: Float32[np.ndarray, "K P"]) -> None:
        """Retain some Gaussians, append new ones with zero moments, and reset the position gradients."""
        none = np.zeros_like(new)
        self.table = np.concatenate([self.table[rows], new])
        self.first = np.concatenate([self.first[rows], none])
        self.second = np.concatenate([self.second[rows], none])
        self.pull = np.zeros((2, len(self.table)), np.float32)
