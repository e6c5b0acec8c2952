"""Devoxelization, Dev(·) of paper eq. 1: from spectra of voxels to spectra of vertices."""
