"""Gaussian splats: one module per file format, its reader and writer together."""
