"""The eight exact symmetries of a voxel grid: quarter turns about the vertical, and their mirrors."""

SIDES: tuple[tuple[tuple[int, int, int], tuple[int, int, int]], ...] = tuple(
    (axes, (east, north, 1)) for axes in ((0, 1, 2), (1, 0, 2)) for east in (1, -1) for north in (1, -1)
)
"""Axes and signs of the turns by 90° about the vertical, and of their mirrors."""
