"""A tree-like set of voxels of any number: random walks from a trunk, as many as it takes."""

import numpy as np


def walk_coords(num_voxels: int, resolution: int, rng: np.random.Generator) -> np.ndarray:
    """Unique voxel indices [num_voxels, 3], branches one voxel thick."""
    half = resolution // 2
    seen: dict[tuple[int, int, int], None] = {(half, half, height): None for height in range(half)}
    trunk = list(seen)
    while len(seen) < num_voxels:
        place = np.array(trunk[int(rng.integers(len(trunk) // 3, len(trunk)))], np.float64)
        heading = rng.standard_normal(3)
        for _ in range(half):
            heading = heading + 0.3 * rng.standard_normal(3)
            heading /= np.linalg.norm(heading)
            place = np.clip(place + heading, 0, resolution - 1)
            seen[(int(place[0]), int(place[1]), int(place[2]))] = None
    return np.array(list(seen)[:num_voxels], np.int64)
