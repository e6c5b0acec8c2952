"""Meshes for jobs that take as long as is wanted."""

import numpy as np


def bumpy_sphere(rings: int, seed: int = 0, width: float = 1.0) -> bytes:
    """A closed surface of rings² quads as OBJ, 2 m high; more rings, more work."""
    rng = np.random.default_rng(seed)
    around = np.linspace(0, 2 * np.pi, rings, endpoint=False)
    down = np.linspace(0.05, np.pi - 0.05, rings)
    radius = 1 + 0.05 * rng.standard_normal((rings, rings))
    x = radius * np.sin(down)[:, None] * np.cos(around)
    y = radius * np.sin(down)[:, None] * np.sin(around)
    z = radius * np.cos(down)[:, None] + 1.2
    vertices = np.stack([width * x, width * y, z], axis=-1).reshape(-1, 3)
    i, j = np.meshgrid(np.arange(rings - 1), np.arange(rings), indexing="ij")
    corner, right = i * rings + j, i * rings + (j + 1) % rings
    quads = np.stack([corner, right, right + rings, corner + rings], axis=-1).reshape(-1, 4) + 1
    lines = ["v {:.5f} {:.5f} {:.5f}".format(*v) for v in vertices.tolist()]
    lines += ["f {} {} {} {}".format(*q) for q in quads.tolist()]
    return "\n".join(lines).encode()
