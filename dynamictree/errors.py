"""Exceptions that the library raises on purpose.

    DynamicTreeError
    ├── InputError              an input cannot be used
    │   ├── MeshError           the geometry: empty, not finite, flat, too large
    │   └── FormatError         the file: not the format, truncated, refers outside itself
    ├── CheckpointError         a model file that does not fit the code
    ├── NumericsError           a result that is not finite or not stable
    │   └── UnstableTimestep    an integrator's step is too long; `max_dt_s` is the longest
    ├── ReconstructionError     photos from which no shape can be made
    ├── CameraSearchError       the external program that finds cameras crashed
    └── Cancelled               the caller asked to stop

Each class has a `code` (stable, kebab-case), by which the service chooses status and problem type. A message says
what was found, what is allowed, and what to change.
"""

from typing import ClassVar


class DynamicTreeError(Exception):
    """Root of the tree; catch this to catch all that the library raises on purpose."""

    code: ClassVar[str] = "dynamictree-error"


class InputError(DynamicTreeError):
    """An input cannot be used."""

    code = "invalid-input"


class MeshError(InputError):
    """Geometry that is empty, not finite, without extent, or too large."""

    code = "invalid-geometry"


class FormatError(InputError):
    """A file that is not of its format, is truncated, or refers outside itself."""

    code = "unsupported-format"


class CheckpointError(DynamicTreeError):
    """A model file that does not fit the code."""

    code = "model-error"


class NumericsError(DynamicTreeError):
    """A result that is not finite, or an integration that is not stable."""

    code = "numerics-error"


class UnstableTimestep(NumericsError):
    """A time step at which an integrator diverges."""

    code = "unstable-timestep"

    def __init__(self, message: str, *, max_dt_s: float) -> None:
        super().__init__(message)
        self.max_dt_s = max_dt_s  # the longest stable step [s]; 0 if no step is stable


class ReconstructionError(DynamicTreeError):
    """Photos from which no shape can be made; the message says how many fitted together and what would help."""

    code = "reconstruction-failed"


class CameraSearchError(DynamicTreeError):
    """A crash of the external program that finds cameras: the program, not the photos, is at fault."""

    code = "camera-search-failed"


class Cancelled(DynamicTreeError):
    """The caller asked to stop; raised out of a progress callback."""

    code = "canceled"
