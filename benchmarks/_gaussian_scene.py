"""Scene of the Gaussian benchmarks."""

import numpy as np

from dynamictree.mesh import TriangleMesh


def wavy_sheet(num_faces: int) -> TriangleMesh:
    """Return a wavy sheet of 4 m, whose faces are all different and small."""
    side = round((num_faces / 2) ** 0.5) + 1
    x, y = np.meshgrid(*[np.linspace(0, 4, side)] * 2, indexing="ij")
    vertices = np.stack([x, y, 0.3 * np.sin(3 * x) * np.cos(2 * y)], axis=-1).reshape(-1, 3).astype(np.float32)
    i = np.arange(side * side, dtype=np.int32).reshape(side, side)
    lower = np.stack([i[:-1, :-1], i[1:, :-1], i[1:, 1:]], axis=-1).reshape(-1, 3)
    upper = np.stack([i[:-1, :-1], i[1:, 1:], i[:-1, 1:]], axis=-1).reshape(-1, 3)
    # neighbours in space are neighbours in the file, as modelling programs write them
    return TriangleMesh(vertices=vertices, faces=np.stack([lower, upper], axis=1).reshape(-1, 3))
