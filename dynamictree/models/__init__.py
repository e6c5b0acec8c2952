"""Trained models: `small`, which is shipped as the default, and `paper`, the network of the paper."""

from dynamictree.models.load import load_model, loaded_once
from dynamictree.models.motion_model import MotionModel

__all__ = ["MotionModel", "load_model", "loaded_once"]
