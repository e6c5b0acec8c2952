"""Evaluation of models: figures, baselines, procedural wind, a classifier and CLIP."""
