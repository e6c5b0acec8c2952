"""Extract a mesh from a cloud, for captures without a mesh: opacity on a grid, then marching cubes.

The network's condition only needs the occupied voxels, and binding only a face near each Gaussian.
"""

from dataclasses import replace
from typing import no_type_check

import numpy as np
from jaxtyping import Float32, Int32, UInt8
from scipy.ndimage import binary_closing, binary_dilation, label
from scipy.spatial import KDTree

from dynamictree.errors import InputError
from dynamictree.gaussian.cloud import GaussianCloud
from dynamictree.gaussian.harmonics import SH_0
from dynamictree.mesh import MeshLook, TriangleMesh, join_meshes
from dynamictree.parallel import compiled, in_bands
from dynamictree.rotation import quaternion_matrices

CELLS_ALONG = 256
"""Grid cells along the largest extent: two per voxel of the paper's 128³ grid."""
LEVEL = 0.3
"""Level of the surface: share of the peak opacity of an isolated opaque Gaussian, as in SuGaR."""
MAX_FACES = 24_000
LEAST_FACES = 10_000
"""Limit of faces that even few Gaussians, or each of several trees, may have."""
FACES_PER_GAUSSIAN = 4
"""More faces add no detail beyond that of the Gaussians, and every vertex costs time at devoxelization."""
_REACH_SIGMAS = 2.5  # [standard deviations]; beyond, a Gaussian adds less than a sixth of the level
_BRIDGE_CELLS = 2  # [cells]; gaps of up to twice this width in a hollow capture are closed


def mesh_of_cloud(
    cloud: GaussianCloud, *, cells_along: int = CELLS_ALONG, max_faces: int = MAX_FACES, one_skin: bool = False
) -> TriangleMesh:
    """Extract a closed surface around the Gaussians, with their colours.

    Args:
        cloud: the Gaussians.
        cells_along: grid cells along the largest extent.
        max_faces: number of faces to which it is simplified.
        one_skin: whether to fill narrow gaps with some opacity; photos give a surface two layers with bridges.

    Raises:
        InputError: no part is opaque enough to have a surface.
    """
    border = 3  # empty cells around the cloud, so that the surface is closed
    gap, some = 2, 0.3  # half width of a filled gap [cells]; share of the level, since gaps between twigs are empty
    import fast_simplification
    from skimage.measure import marching_cubes

    visible = cloud.subset(cloud.opacity >= LEVEL * 0.5) if (cloud.opacity >= LEVEL * 0.5).any() else cloud
    low, high = _bounds(visible)
    cell = float((high - low).max()) / cells_along
    if not cell > 0:
        raise InputError("all Gaussians are points at one place; a surface needs an extent")
    origin = low - border * cell
    shape = np.ceil((high - origin) / cell).astype(np.int64) + border
    density = opacity_grid(visible, origin.astype(np.float32), cell, (int(shape[0]), int(shape[1]), int(shape[2])))
    if density.max() <= LEVEL:
        raise InputError(f"the cloud is nowhere denser than {density.max():.2g}; a surface needs more than {LEVEL}")
    density[[0, -1]] = density[:, [0, -1]] = density[:, :, [0, -1]] = 0
    if one_skin:
        gaps = binary_closing(density > LEVEL, iterations=gap) & (density > some * LEVEL)
        np.maximum(density, np.float32(1.05 * LEVEL), out=density, where=gaps)
        del gaps
    _fill(density)
    points, faces, _, _ = marching_cubes(density, LEVEL)  # type: ignore[no-untyped-call]
    del density  # hundreds of megabytes; simplification takes as much again
    faces = np.ascontiguousarray(faces[:, ::-1], np.int32)  # orientation outward, where opacity falls
    if len(faces) > max_faces:
        points, faces = fast_simplification.simplify(
            np.ascontiguousarray(points, np.float32), faces, target_count=max_faces
        )
    vertices = (points * cell + origin + 0.5 * cell).astype(np.float32)
    return TriangleMesh(
        vertices=vertices,
        faces=faces.astype(np.int32),
        look=MeshLook(vertex_colors=_colors(visible, vertices)),
        source=cloud.source,
    )


def mesh_of_trees(cloud: GaussianCloud, tree: Int32[np.ndarray, " G"] | None = None) -> TriangleMesh:
    """Extract the surface of one tree, or of several trees, each on its own grid.

    Raises:
        InputError: no part is opaque enough to have a surface.
    """
    cells_along_tree = 160  # `CELLS_ALONG` for each of several trees
    if tree is None or len(numbers := np.unique(tree)) == 1:
        most = max(LEAST_FACES, FACES_PER_GAUSSIAN * cloud.num_gaussians)
        return mesh_of_cloud(cloud, max_faces=min(MAX_FACES, most))
    most = max(MAX_FACES // len(numbers), LEAST_FACES)
    parts = [
        mesh_of_cloud(cloud.subset(tree == number), cells_along=cells_along_tree, max_faces=most) for number in numbers
    ]
    face_tree = np.repeat(np.arange(len(parts), dtype=np.int32), [part.num_faces for part in parts])
    return replace(join_meshes(parts), face_tree=face_tree, source=cloud.source)


def _fill(density: Float32[np.ndarray, "X Y Z"]) -> None:
    """Fill the enclosed space: captures are hollow, so a trunk would get a second surface inside.

    Gaps of a few cells are bridged. The bottom, which cameras and scanners do not see, may be open; a floor closes
    it.
    """
    margin = _BRIDGE_CELLS + 1  # margin that connects the outside
    floor = int(np.flatnonzero(density.max(axis=(0, 1)) > LEVEL)[0])
    free = ~binary_dilation(np.pad(density > LEVEL, margin), iterations=_BRIDGE_CELLS)
    free[:, :, : floor + margin + 1] = False
    part, _ = label(np.pad(free[1:-1, 1:-1, 1:-1], 1, constant_values=True))  # the border is outside
    # the inside is extended by the dilation of the walls
    inside = binary_dilation(free & (part != part[0, 0, 0]), iterations=_BRIDGE_CELLS + 1)
    inside = inside[margin:-margin, margin:-margin, margin:-margin]
    inside[:, :, :floor] = False
    np.maximum(density, np.float32(2 * LEVEL), out=density, where=inside & (density <= LEVEL))


def opacity_grid(
    cloud: GaussianCloud, origin: Float32[np.ndarray, "3"], cell: float, shape: tuple[int, int, int]
) -> Float32[np.ndarray, "X Y Z"]:
    """Compute Σ opacity · exp(-½ dᵀ Σ⁻¹ d) at the cells' centres, with Gaussians at least half a cell thick."""
    least_sigma = 0.5  # [cells]; thinner Gaussians are widened so that none falls between cells
    axes = quaternion_matrices(cloud.quaternions)
    sigma = np.maximum(cloud.scales / np.float32(cell), np.float32(least_sigma))  # [cells]
    precision = (axes / sigma[:, None, :] ** 2) @ axes.transpose(0, 2, 1)  # [G, 3, 3]
    spread = np.sqrt(((axes * sigma[:, None, :]) ** 2).sum(axis=2))  # standard deviations along x, y, z [G, 3]
    centres = (cloud.means - origin) / np.float32(cell) - np.float32(0.5)
    density = np.zeros(shape, np.float32)
    in_bands(
        _splat_slices,
        shape[0],
        centres,
        np.ascontiguousarray(precision),
        spread * np.float32(_REACH_SIGMAS),
        cloud.opacity,
        density,
    )
    return density


@compiled
@no_type_check
def _splat_slices(first, end, centres, precision, reach, opacity, density):
    """Add every Gaussian to the slices of x in this band."""
    for g in range(len(centres)):
        cx, cy, cz = centres[g]
        from_x, to_x = max(int(np.ceil(cx - reach[g, 0])), first), min(int(np.floor(cx + reach[g, 0])) + 1, end)
        if from_x >= to_x:
            continue
        from_y, to_y = (
            max(int(np.ceil(cy - reach[g, 1])), 0),
            min(int(np.floor(cy + reach[g, 1])) + 1, density.shape[1]),
        )
        from_z, to_z = (
            max(int(np.ceil(cz - reach[g, 2])), 0),
            min(int(np.floor(cz + reach[g, 2])) + 1, density.shape[2]),
        )
        p = precision[g]
        for x in range(from_x, to_x):
            dx = x - cx
            for y in range(from_y, to_y):
                dy = y - cy
                constant = p[0, 0] * dx * dx + p[1, 1] * dy * dy + 2 * p[0, 1] * dx * dy
                slope = 2 * (p[0, 2] * dx + p[1, 2] * dy)
                for z in range(from_z, to_z):
                    dz = z - cz
                    distance = constant + dz * (slope + p[2, 2] * dz)
                    if distance < 6.25:  # `_REACH_SIGMAS` squared
                        density[x, y, z] += opacity[g] * np.exp(-0.5 * distance)


def _bounds(cloud: GaussianCloud) -> tuple[Float32[np.ndarray, "3"], Float32[np.ndarray, "3"]]:
    """Return the low and high corner of the grid's contents."""
    far_out = 0.1  # share of the others' extent
    strays = 0.002  # share of Gaussians at each end of an axis that, if far out, do not widen the grid
    reach = np.float32(_REACH_SIGMAS) * cloud.scales.max(axis=1, keepdims=True)
    if np.ptp(cloud.means, axis=0).max() < np.median(reach):  # few overlapping Gaussians: their own extent counts
        return (cloud.means - reach).min(axis=0), (cloud.means + reach).max(axis=0)
    low, high = (np.quantile(cloud.means, q, axis=0) for q in (strays, 1 - strays))
    margin = far_out * (high - low).max()
    lowest, highest = cloud.means.min(axis=0), cloud.means.max(axis=0)
    return np.maximum(lowest, low - margin).astype(np.float32), np.minimum(highest, high + margin).astype(np.float32)


def _colors(cloud: GaussianCloud, vertices: Float32[np.ndarray, "N 3"]) -> UInt8[np.ndarray, "N 4"]:
    """Return the sRGB colour of the nearest Gaussian, averaged over all directions."""
    nearest = np.asarray(KDTree(cloud.means).query(vertices)[1])
    color = np.clip(cloud.sh[nearest, 0] * SH_0 + 0.5, 0, 1) * 255
    return np.concatenate([np.rint(color), np.full((len(vertices), 1), 255)], axis=1).astype(np.uint8)
