"""Model-independent parts of training: trainer, learning rates, checkpoints, processes."""
