"""DynamicTree: captured trees that move, by a sparse voxel spectrum. The method alone; no HTTP, queue or database."""
