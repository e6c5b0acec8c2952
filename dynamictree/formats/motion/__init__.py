"""Motions for other programs: frame sequences, USD and vertex animation textures."""
