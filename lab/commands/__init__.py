"""The commands of `dynamictree` that this package adds: `dataset`, `train` and `evaluate`."""
