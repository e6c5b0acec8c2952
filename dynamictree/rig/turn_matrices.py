"""Matrices for the fit of rotations: skinning of points, growth of edges, and coupling of neighbours."""

from dataclasses import dataclass
from typing import no_type_check

import numpy as np
import scipy.sparse
from jaxtyping import Complex64, Float32, Float64, Int, Int32

from dynamictree.parallel import compiled, in_bands
from dynamictree.rig.pose import Poses, Skeleton, Weights

TURN_COST = 0.2
"""Cost of a bone's rotation relative to its parent, in units of moving a voxel at its end as far. Measured on six grown
trees (docs/decisions/modal.md): 1 suppresses flutter, 0.05 rotates bones without data."""
TURN_COST_ACROSS_EDGES = 3.0
"""The same relative to another bone connected by edges, as in a crown that is one surface."""
STRETCH_FACTOR_IN_CROWN = 10.0
"""Factor of the edges' cost in a one-surface crown: it has no cards, which rotate freely, and stretched by 22 %."""
MAX_EDGES = 60_000  # number of edges used of a larger mesh, evenly chosen, since stretch is a mean
_SHORTEST_EDGE = 0.25  # [voxels]; shorter edges have no higher weight


@dataclass(frozen=True, kw_only=True)
class Target:
    """N points that the bones carry, edges between them, and the motion of V voxels, which average them."""

    points: Float32[np.ndarray, "N 3"]
    edges: Int32[np.ndarray, "E 2"]
    mean: scipy.sparse.csr_array  # [V, N], rows sum to 1
    coefficients: Complex64[np.ndarray, "V K 3"]  # [m]
    num_frames: int  # number of frames T of the spectrum
    voxel_m: float

    @property
    def fitted_edges(self) -> Int32[np.ndarray, "F 2"]:
        """At most `MAX_EDGES` of the edges, evenly chosen."""
        return self.edges[:: -(-max(len(self.edges), 1) // MAX_EDGES)]


def skinning_matrix(skeleton: Skeleton, weights: Weights, points: Float32[np.ndarray, "N 3"]) -> scipy.sparse.csr_array:
    """Return the skinning matrix [N, 4B] for `stack_poses`: shares, then shares times each arm."""
    num_bones, (num_points, width) = len(skeleton), weights.rows.shape
    arm = points[:, None].astype(np.float64) - skeleton.foot_m[weights.rows]  # [N, W, 3]
    values = np.concatenate([np.ones((num_points, width, 1)), arm], axis=2) * weights.shares[:, :, None]
    columns = weights.rows[:, :, None] + num_bones * np.arange(4)
    used = np.broadcast_to(weights.shares[:, :, None] > 0, values.shape)
    row = np.repeat(np.arange(num_points), used.sum(axis=(1, 2)))
    return scipy.sparse.csr_array((values[used], (row, columns[used])), shape=(num_points, 4 * num_bones))


def stack_poses(pose: Poses) -> Float64[np.ndarray, "B4 3 T"]:
    """Stack feet and columns of the rotations, which `skinning_matrix` multiplies."""
    parts = [pose.place_m, *(pose.rotation[..., column] for column in range(3))]
    return np.concatenate([part.transpose(1, 2, 0) for part in parts])


def edge_differences(
    skeleton: Skeleton, weights: Weights, target: Target
) -> tuple[scipy.sparse.csr_array, Float64[np.ndarray, " E"], Float64[np.ndarray, " E"]]:
    """Return differences [E, N] of the edges that can grow, their lengths [m] and the weights of their growth."""
    edges = target.fitted_edges
    length = np.linalg.norm(target.points[edges[:, 0]].astype(np.float64) - target.points[edges[:, 1]], axis=1)
    one, other = weights.rows[edges[:, 0]], weights.rows[edges[:, 1]]
    single = (weights.shares[edges, 0] == 1).all(axis=1)
    can_grow = (length > 0) & ~(single & (one[:, 0] == other[:, 0]))
    edges, length = edges[can_grow], length[can_grow]
    dear = np.sqrt(np.where(skeleton.in_surface[weights.rows[edges, 0]].all(axis=1), STRETCH_FACTOR_IN_CROWN, 1))
    scale = dear * target.voxel_m / np.maximum(length, _SHORTEST_EDGE * target.voxel_m)
    signs = np.tile([1.0, -1.0], len(edges))
    shape = (len(edges), len(target.points))
    return scipy.sparse.csr_array((signs, edges.ravel(), 2 * np.arange(len(edges) + 1)), shape=shape), length, scale


def turn_jacobian(theta: Float64[np.ndarray, "B 3"]) -> Float64[np.ndarray, "B 3 3"]:
    """Return the matrices from a change of θ to the small rotation [rad] of R(θ)."""
    cosine = (1 / np.sqrt(1 + (theta**2).sum(axis=1)))[:, None, None]
    outer = theta[:, :, None] * theta[:, None, :]
    return np.asarray(cosine * np.eye(3) - cosine**3 / (1 + cosine) * outer + cosine**2 / (1 + cosine) * skew(theta))


def linearise(
    skeleton: Skeleton, skin: scipy.sparse.csr_array, pose: Poses, *, feet: int, swing: Float64[np.ndarray, "B 3 3"]
) -> tuple[scipy.sparse.csr_array, scipy.sparse.csr_array]:
    """Linearise the displacements of the rows of `skin` [m] and the feet's gaps from their parents [m].

    The small rotations are `swing` θ; `feet` is the block of the unknowns with the displacements of the feet.
    """
    num_bones, above = len(skeleton), skeleton.above
    rotation = pose.rotation[0]
    carries = skin[:, :num_bones].tocoo()
    arms = skin[:, num_bones:].tocoo()
    column, bone = np.divmod(arms.col, num_bones)
    keys, pair = np.unique(arms.row * np.int64(num_bones) + bone, return_inverse=True)
    row, bone = np.divmod(keys, num_bones)
    turned = rotation[bone[pair], :, column] * arms.data[:, None]
    arm = np.stack([np.bincount(pair, turned[:, i], len(keys)) for i in range(3)], axis=1)
    one = np.eye(3)
    moves = _blocks(
        (skin.shape[0], num_bones),
        (carries.row, feet * num_bones + carries.col, carries.data[:, None, None] * one),
        (row, num_bones + bone, -skew(arm) @ swing[bone]),
    )
    foot, each = skeleton.foot_m.astype(np.float64), np.arange(num_bones)
    between = np.einsum("bij,bj->bi", rotation[above], foot - foot[above])
    has_parent = (skeleton.parent >= 0)[:, None, None].astype(np.float64)
    chain = _blocks(
        (num_bones, num_bones),
        (each, feet * num_bones + each, np.broadcast_to(one, swing.shape)),
        (each, feet * num_bones + above, -has_parent * one),
        (each, num_bones + above, has_parent * skew(between) @ swing[above]),
    )
    return moves, chain


def coupling(skeleton: Skeleton, weights: Weights, target: Target, voxels: np.ndarray) -> scipy.sparse.csr_array:
    """Build the weighted differences of neighbours' rotations, times the length of the shorter bone [m]; 9B columns."""
    stiff = 0.007  # cost per voxel beyond; with 0.008 a branch's foot leaves the bark by 0.3 % of the height
    beyond, num_bones, parent, one_voxel = voxels.copy(), len(skeleton), skeleton.parent, target.voxel_m**2
    for level in reversed(skeleton.levels):
        np.add.at(beyond, skeleton.above[level], beyond[level])
    joined = np.unique(np.sort(weights.rows[target.edges, 0], axis=1), axis=0)
    first, second = joined[
        (joined[:, 0] != joined[:, 1]) & (parent[joined[:, 0]] != joined[:, 1]) & (parent[joined[:, 1]] != joined[:, 0])
    ].T
    child = np.arange(1, num_bones)
    one, other = np.concatenate([child, first]), np.concatenate([parent[1:], second])
    price = np.repeat([TURN_COST, TURN_COST_ACROSS_EDGES], [len(child), len(first)])
    carried = np.append(beyond[child], np.zeros(len(first)))
    square = (skeleton.reach_m.astype(np.float64) ** 2).sum(axis=1)
    square = np.minimum(square[one], square[other])
    lever_m = np.sqrt(price * (square + one_voxel) + stiff * carried * (square + 10 * one_voxel))
    rows, lever_m = np.arange(len(one)), lever_m[:, None, None] * np.eye(3)
    return _blocks((len(one), num_bones), (rows, num_bones + one, lever_m), (rows, num_bones + other, -lever_m))


def _blocks(
    shape: tuple[int, int], *blocks: tuple[Int[np.ndarray, " _"], Int[np.ndarray, " _"], Float64[np.ndarray, "_ 3 3"]]
) -> scipy.sparse.csr_array:
    """Build a sparse matrix [3 rows, 9 bones] from 3 x 3 blocks, each with row, column and values."""
    row, column = np.mgrid[0:3, 0:3]
    rows = np.concatenate([(3 * r[:, None, None] + row).ravel() for r, _, _ in blocks])
    columns = np.concatenate([(3 * c[:, None, None] + column).ravel() for _, c, _ in blocks])
    values = np.concatenate([v.ravel() for _, _, v in blocks])
    return scipy.sparse.csr_array((values, (rows, columns)), shape=(3 * shape[0], 9 * shape[1]))


def skew(vectors: Float64[np.ndarray, "n 3"]) -> Float64[np.ndarray, "n 3 3"]:
    """Return the skew-symmetric matrices of the cross products v ×."""
    x, y, z = vectors.T
    zero = np.zeros(len(vectors))
    return np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=1).reshape(-1, 3, 3)


def edge_growth(
    vectors: scipy.sparse.csr_array, pose: Poses, length: Float64[np.ndarray, " E"], scale: Float64[np.ndarray, " E"]
) -> Float32[np.ndarray, "E T"]:
    """Compute the weighted growth of edges at T poses; `vectors` times the stacked poses are the edges' vectors [m]."""
    growth = np.empty((len(length), len(pose.place_m)), np.float32)
    places = stack_poses(pose).reshape(-1, 3 * len(pose.place_m))
    arrays = vectors.indptr, vectors.indices, vectors.data, places, length, scale, growth
    in_bands(_grow, len(length), *arrays, rows_per_thread=1000)
    return growth


@compiled
@no_type_check
def _grow(first, end, starts, columns, shares, places, length, scale, growth):
    frames = growth.shape[1]
    vector = np.empty(3 * frames)
    for edge in range(first, end):
        vector[:] = 0
        for place in range(starts[edge], starts[edge + 1]):
            share, column = shares[place], columns[place]
            for i in range(3 * frames):
                vector[i] += share * places[column, i]
        for t in range(frames):
            x, y, z = vector[t], vector[frames + t], vector[2 * frames + t]
            growth[edge, t] = (np.sqrt(x * x + y * y + z * z) - length[edge]) * scale[edge]


@compiled
@no_type_check
def add_products(one, other, total):
    """Add the scalar product of each pair of columns of two arrays [n, C] to a total [C], in its precision."""
    for row in range(len(one)):
        for i in range(len(total)):
            total[i] += np.float64(one[row, i]) * other[row, i]
