"""The trained models: `small` is shipped, `paper` is the paper's own network."""
