"""Occupied voxels: where a surface is, and how values get there and back."""
