"""Evaluation of models: figures, baselines, laws of real trees, a classifier and CLIP."""
