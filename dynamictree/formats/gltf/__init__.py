"""glTF and GLB: meshes, Gaussian splats and animations."""
