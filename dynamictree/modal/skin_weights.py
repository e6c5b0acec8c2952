"""Weights of a skin: which few of many rigid motions, mixed, come nearest to the motion of each vertex.

The weights w of a vertex are at least 0 and sum to 1, so its error is w G w, where G has the products of the errors
that each joint alone would make. Joints are chosen greedily among candidates, then exchanged while that helps.
After the weight step of SSDR (Le and Deng 2012).
"""

from typing import no_type_check

import numpy as np
from jaxtyping import Float64, Int64

from dynamictree.parallel import compiled, in_bands
from dynamictree.skin import JOINTS_PER_VERTEX

NEAREST = 8  # candidates that alone come nearest to the vertex
STEEPEST = 8  # candidates that reduce the error of the earlier weights fastest; they may be far from the vertex
_CHUNK = 1500  # vertices whose Gram matrices are in memory at once: 100 MB


def skin_weights(
    points: Float64[np.ndarray, "N 3"],
    targets: Float64[np.ndarray, "T N 3"],
    rotation: Float64[np.ndarray, "T B 3 3"],
    translation: Float64[np.ndarray, "T B 3"],
    earlier: tuple[Int64[np.ndarray, "N 4"], Float64[np.ndarray, "N 4"]] | None = None,
) -> tuple[Int64[np.ndarray, "N 4"], Float64[np.ndarray, "N 4"]]:
    """Joints and weights of each vertex, given where it is at every frame [m]; `earlier` ones become no worse."""
    rows = np.zeros((len(points), JOINTS_PER_VERTEX), np.int64)
    weights = np.zeros((len(points), JOINTS_PER_VERTEX))
    affine = np.concatenate([rotation, translation[..., None]], axis=3)  # [T, B, 3, 4]
    for first in range(0, len(points), _CHUNK):
        part = slice(first, first + _CHUNK)
        before = None if earlier is None else (earlier[0][part], earlier[1][part])
        candidates = _candidates(points[part], targets[:, part], affine, before)
        gram = _gram(points[part], targets[:, part], affine, candidates)
        in_bands(_choose, len(candidates), gram, candidates, rows[part], weights[part])
    return rows, weights


def joint_errors(
    points: Float64[np.ndarray, "n 3"], targets: Float64[np.ndarray, "T n 3"], affine: Float64[np.ndarray, "T B 3 4"]
) -> Float64[np.ndarray, "n B"]:
    """Sum over frames of the squared distance between a vertex and where each joint alone would carry it [m²]."""
    ones = np.concatenate([points, np.ones((len(points), 1))], axis=1)
    squares = np.einsum("tbij,tbik->bjk", affine, affine, optimize=True)
    error = np.einsum("nj,bjk,nk->nb", ones, squares, ones, optimize=True)
    error -= 2 * _products(ones, targets, affine)
    return np.asarray(error + (targets**2).sum(axis=(0, 2))[:, None])


def _products(
    ones: Float64[np.ndarray, "n 4"], vectors: Float64[np.ndarray, "T n 3"], affine: Float64[np.ndarray, "T B 3 4"]
) -> Float64[np.ndarray, "n B"]:
    """Products of a vertex' vectors with where each joint carries it, summed over frames."""
    flat = vectors.transpose(1, 0, 2).reshape(len(ones), -1)  # [n, 3T]
    total = np.zeros((len(ones), affine.shape[1]))
    for column in range(4):
        total += ones[:, column, None] * (flat @ affine[..., column].transpose(0, 2, 1).reshape(flat.shape[1], -1))
    return total


def _candidates(
    points: Float64[np.ndarray, "n 3"],
    targets: Float64[np.ndarray, "T n 3"],
    affine: Float64[np.ndarray, "T B 3 4"],
    earlier: tuple[Int64[np.ndarray, "n 4"], Float64[np.ndarray, "n 4"]] | None,
) -> Int64[np.ndarray, "n C"]:
    """Joints to choose from; one may stand there twice."""
    num_nearest = min(NEAREST, affine.shape[1])
    nearest = np.argpartition(joint_errors(points, targets, affine), num_nearest - 1, axis=1)[:, :num_nearest]
    if earlier is None:
        return nearest
    ones = np.concatenate([points, np.ones((len(points), 1))], axis=1)
    left = targets - blended(points, affine[..., :3], affine[..., 3], *earlier)
    slope = -_products(ones, left, affine)
    num_steepest = min(STEEPEST, affine.shape[1])
    steepest = np.argpartition(slope, num_steepest - 1, axis=1)[:, :num_steepest]
    return np.concatenate([earlier[0], steepest, nearest], axis=1)


def blended(
    points: Float64[np.ndarray, "n 3"],
    rotation: Float64[np.ndarray, "T B 3 3"],
    translation: Float64[np.ndarray, "T B 3"],
    rows: Int64[np.ndarray, "n W"],
    weights: Float64[np.ndarray, "n W"],
) -> Float64[np.ndarray, "T n 3"]:
    """Where the joints carry the points, by their weights."""
    moved = np.zeros((len(rotation), *points.shape))
    for joint, weight in zip(rows.T, weights.T, strict=True):
        turned = np.matmul(rotation[:, joint], points[:, :, None])[..., 0] + translation[:, joint]
        moved += weight[:, None] * turned
    return moved


def _gram(
    points: Float64[np.ndarray, "n 3"],
    targets: Float64[np.ndarray, "T n 3"],
    affine: Float64[np.ndarray, "T B 3 4"],
    candidates: Int64[np.ndarray, "n C"],
) -> Float64[np.ndarray, "n C C"]:
    by_joint = np.ascontiguousarray(affine.transpose(1, 0, 2, 3))  # [B, T, 3, 4]
    shape = (len(points), candidates.shape[1], -1)
    ones = np.concatenate([points, np.ones((len(points), 1))], axis=1)
    error = np.matmul(by_joint[candidates].reshape(*shape[:2], -1, 4), ones[:, None, :, None]).reshape(shape)
    error -= targets.transpose(1, 0, 2).reshape(len(points), 1, -1)
    return np.asarray(error @ error.transpose(0, 2, 1))


@compiled
@no_type_check  # numba compiles no checked function
def _choose(
    first: int,
    end: int,
    gram: Float64[np.ndarray, "n C C"],
    candidates: Int64[np.ndarray, "n C"],
    rows: Int64[np.ndarray, "n 4"],
    weights: Float64[np.ndarray, "n 4"],
) -> None:
    """Choose joints of the vertices from `first` to `end`."""
    small = np.empty((4, 4))
    trial, chosen = np.empty(4, np.int64), np.empty(4, np.int64)
    mixed, best = np.empty(4), np.empty(4)
    for vertex in range(first, end):
        own, names = gram[vertex], candidates[vertex]
        count = len(names)
        least, used = np.inf, 0
        for step in range(12):  # four additions, then two exchanges of each
            slot = step if step < 4 else step % 4
            if step >= 4 and slot >= used:
                continue
            if step < 4 and step != used:
                continue
            picked = -1
            size = max(used, slot + 1)
            for other in range(count):
                taken = False
                for place in range(used):
                    taken = taken or names[chosen[place]] == names[other]
                if taken:
                    continue
                for place in range(size):
                    trial[place] = other if place == slot else chosen[place]
                for a in range(size):
                    for b in range(size):
                        small[a, b] = own[trial[a], trial[b]]
                error = _mix(small, size, mixed)
                if error < least * (1 - 1e-9):
                    least, picked = error, other
                    best[:] = mixed
            if picked >= 0:
                chosen[slot] = picked
                used = size
                for place in range(used):
                    rows[vertex, place] = names[chosen[place]]
                    weights[vertex, place] = best[place]


@compiled
@no_type_check
def _mix(gram: Float64[np.ndarray, "4 4"], size: int, weights: Float64[np.ndarray, "4"]) -> float:
    """Least w G w for w of at least 0 that sum to 1, over all sets of positive weights; gives the minimum."""
    best = np.inf
    solved = np.empty((4, 5))
    index, solution = np.empty(4, np.int64), np.empty(4)
    ridge = 1e-15
    for a in range(size):
        ridge += 1e-10 * gram[a, a]
    for mask in range(1, 1 << size):
        n = 0
        for a in range(size):
            if mask >> a & 1:
                index[n] = a
                n += 1
        for a in range(n):
            for b in range(n):
                solved[a, b] = gram[index[a], index[b]] + (ridge if a == b else 0.0)
            solved[a, n] = 1.0
        for a in range(n):  # positive definite: no pivots needed
            for b in range(a + 1, n):
                factor = solved[b, a] / solved[a, a]
                for c in range(a, n + 1):
                    solved[b, c] -= factor * solved[a, c]
        total, sound = 0.0, True
        for a in range(n - 1, -1, -1):
            value = solved[a, n]
            for b in range(a + 1, n):
                value -= solved[a, b] * solution[b]
            solution[a] = value / solved[a, a]
            sound = sound and solution[a] >= 0
            total += solution[a]
        if sound and total > 0 and 1 / total < best:
            best = 1 / total
            weights[:] = 0.0
            for a in range(n):
                weights[index[a]] = solution[a] / total
    return best
