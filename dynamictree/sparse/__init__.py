"""Sparse tensors on plain PyTorch: one row of features per voxel; a `SparseLevel` lists which rows are neighbours."""
