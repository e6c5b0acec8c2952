"""DynamicTree: captured trees that move, by a sparse voxel spectrum. The method alone; it knows no HTTP, queue or database."""
