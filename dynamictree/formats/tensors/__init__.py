"""The project's own files, which are safetensors: spectra, voxels, motions and bundles between processes."""
