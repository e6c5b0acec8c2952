"""What a model is measured by: figures, baselines, a procedural rival, a classifier and CLIP."""
