"""Locations of trained weights: shipped ones in this folder, the user's own in the folder DYNAMICTREE_MODELS."""

import os
from pathlib import Path

from dynamictree.errors import InputError

SHIPPED = Path(__file__).parent
SUFFIX = ".safetensors"
CHECKPOINT = "checkpoint"
"""File name of a training's state, which is beside the weights in a run's folder."""
ENVIRONMENT_VARIABLE = "DYNAMICTREE_MODELS"


def list_weights() -> dict[str, Path]:
    """Return weights files by model name. A user's model replaces a shipped one of the same name."""
    folders = [SHIPPED]
    if os.environ.get(ENVIRONMENT_VARIABLE):
        folders.append(Path(os.environ[ENVIRONMENT_VARIABLE]))
    files = [path for folder in folders for path in sorted(folder.glob(f"*{SUFFIX}"))]
    return {path.stem: path for path in files if path.stem != CHECKPOINT}


def weights_path(name_or_path: str) -> Path:
    """Return the weights file of a model, by its name or its path.

    Raises:
        InputError: there is no such model.
    """
    available = list_weights()
    path = Path(name_or_path) if name_or_path.endswith(SUFFIX) else available.get(name_or_path)
    if path is None or not path.is_file():
        names = ", ".join(sorted(available)) or "none"
        raise InputError(f"there is no model {name_or_path!r}; available: {names}; or give a {SUFFIX} file")
    return path
