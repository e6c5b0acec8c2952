"""Devoxelization, Dev(·) in paper eq. 1: from spectra of voxels to spectra of vertices."""
