"""Voxelization: occupied voxels of a surface, and averages of vertex values in each."""
