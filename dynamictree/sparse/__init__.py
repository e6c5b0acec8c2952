"""Sparse tensors on plain PyTorch: features in rows, one a voxel; a `SparseLevel` says which rows are neighbours."""
