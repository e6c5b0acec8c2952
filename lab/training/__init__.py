"""Parts of training that do not depend on the model: trainer, learning rates, checkpoints, processes."""
