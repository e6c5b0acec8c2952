"""A skin fitted to a loop: joints, their rigid motions and the weights, all fitted to the vertices' motion.

After Le and Deng 2012 (smooth skinning decomposition with rigid bones): vertices that move alike make the first joints,
then weights and motions are fitted in turn, each against what the others leave. A joint may carry vertices far apart;
for joints that lie in branches see `branch_skin.py`.
"""

from collections.abc import Callable
from itertools import pairwise

import numpy as np
from jaxtyping import Bool, Complex64, Float64, Int64

from dynamictree.mesh import TriangleMesh
from dynamictree.modal.branch_skin import carried, nearest_rigid_motion, summary_of
from dynamictree.modal.skin_weights import blended, joint_errors, skin_weights
from dynamictree.skin import Skin, SkinSummary
from dynamictree.spectrum import iter_motion

FITTED_VERTICES = 6_000  # of a larger mesh, evenly chosen; all get weights, and count in the reported error
ROUNDS = 5  # of weights and motions in turn
CLUSTER_ROUNDS = 3  # of each number of clusters
SMALLEST_CLUSTER = 8  # vertices; two joints are not made of fewer
_STILL_M = 1e-6  # vertices that move less hang on the root, which never moves
_CARRIES = 1e-4  # weight below which a vertex does not guide a joint

_CLUSTERS_SHARE, _FIT_SHARE, _WEIGHTS_SHARE = 0.3, 0.7, 0.9  # of the time, about

OnProgress = Callable[[float], None]
Motions = tuple[Float64[np.ndarray, "T B 3 3"], Float64[np.ndarray, "T B 3"]]


def fitted_skin(
    mesh: TriangleMesh,
    coefficients: Complex64[np.ndarray, "N K 3"],
    *,
    num_frames: int,
    num_joints: int,
    on_progress: OnProgress = lambda done: None,
) -> tuple[Skin, SkinSummary]:
    """Fit at most `num_joints` joints to one period of `num_frames` frames. Joint 0 is the root, at rest always.

    `on_progress` gets the share done; what it raises passes through.
    """
    points = mesh.vertices.astype(np.float64)
    few = 2 * coefficients.shape[1] + 1  # frames that determine the loop, and its interpolation between them
    moving = np.abs(coefficients).max(axis=(1, 2)) > _STILL_M
    rows, weights = np.zeros((len(points), 4), np.int64), np.tile([1.0, 0, 0, 0], (len(points), 1))
    rotation, translation = _at_rest(num_frames, 1)
    if moving.any():
        guides = np.flatnonzero(moving)
        guides = guides[:: -(-len(guides) // FITTED_VERTICES)]
        motions = _fit(
            points[guides], _positions(points, coefficients, guides, few, num_frames), num_joints, on_progress
        )
        rows[moving], weights[moving] = _weights_of_all(points, coefficients, moving, motions, num_frames, on_progress)
        motions = _interpolated(motions, num_frames)
        targets = _positions(points, coefficients, guides, num_frames, num_frames)
        rotation, translation = _refitted(points[guides], targets, motions, rows[guides], weights[guides])
    rows, rotation, translation = _used_alone(rows, weights, rotation, translation)
    parent = np.zeros(rotation.shape[1], np.int32)
    parent[0] = -1
    skin = Skin(
        parent=parent,
        joint_m=_places(points, rows, weights, len(parent)).astype(np.float32),
        rows=rows.astype(np.int32),
        weights=weights.astype(np.float32),
        rotation=rotation.astype(np.float32),
        translation_m=translation.astype(np.float32),
    )
    return skin, summary_of(skin, mesh.vertices, coefficients, num_frames)


def _positions(
    points: Float64[np.ndarray, "N 3"],
    coefficients: Complex64[np.ndarray, "N K 3"],
    chosen: Int64[np.ndarray, " n"],
    count: int,
    num_frames: int,
) -> Float64[np.ndarray, "T n 3"]:
    """Where the chosen vertices are at `count` times of the loop [m]."""
    moved = np.stack(list(iter_motion(coefficients[chosen], np.arange(count) / count, num_frames)))
    return np.asarray(points[chosen] + moved.astype(np.float64))


def _at_rest(num_frames: int, num_joints: int) -> Motions:
    return np.tile(np.eye(3), (num_frames, num_joints, 1, 1)), np.zeros((num_frames, num_joints, 3))


def _fit(
    points: Float64[np.ndarray, "n 3"], targets: Float64[np.ndarray, "T n 3"], num_joints: int, on_progress: OnProgress
) -> Motions:
    """Motions of joints, the first of which stays at rest."""
    rotation, translation = _clusters(points, targets, num_joints - 1, on_progress)
    still = _at_rest(len(targets), 1)
    motions: Motions = (np.concatenate([still[0], rotation], 1), np.concatenate([still[1], translation], 1))
    earlier = None
    for number in range(ROUNDS):
        on_progress(_CLUSTERS_SHARE + (_FIT_SHARE - _CLUSTERS_SHARE) * number / ROUNDS)
        earlier = skin_weights(points, targets, *motions, earlier)
        motions = _refitted(points, targets, motions, *earlier)
    return motions


def _clusters(
    points: Float64[np.ndarray, "n 3"], targets: Float64[np.ndarray, "T n 3"], count: int, on_progress: OnProgress
) -> Motions:
    """Rigid motions of clusters of vertices, doubled until there are as many: the worst split first."""
    label = np.zeros(len(points), np.int64)
    num = 1
    while True:
        on_progress(_CLUSTERS_SHARE * (num / max(count, 1)) / 2)
        rotation, translation = _at_rest(len(targets), num)
        for _ in range(CLUSTER_ROUNDS):
            for cluster in np.unique(label).tolist():
                at = np.flatnonzero(label == cluster)
                motion = nearest_rigid_motion(points[at], targets[:, at], np.ones(len(at)))
                rotation[:, cluster], translation[:, cluster] = motion
            on_progress(_CLUSTERS_SHARE * (num / max(count, 1)) / 2)
            error = joint_errors(points, targets, np.concatenate([rotation, translation[..., None]], axis=3))
            label = error.argmin(axis=1)
        own = error[np.arange(len(points)), label]
        before = num
        for cluster in np.argsort(-np.bincount(label, own, minlength=num), kind="stable")[: min(num, count - num)]:
            at = np.flatnonzero(label == cluster)
            if len(at) >= SMALLEST_CLUSTER:
                worst = at[own[at].argmax()]
                near = at[np.argsort(((points[at] - points[worst]) ** 2).sum(axis=1), kind="stable")]
                label[near[: len(at) // 2]] = num
                num += 1
        if num == before:
            return rotation, translation


def _refitted(
    points: Float64[np.ndarray, "n 3"],
    targets: Float64[np.ndarray, "T n 3"],
    motions: Motions,
    rows: Int64[np.ndarray, "n 4"],
    weights: Float64[np.ndarray, "n 4"],
) -> Motions:
    """One joint after the other, each against what the others leave; the root stays."""
    rotation, translation = motions[0].copy(), motions[1].copy()
    left = targets - blended(points, rotation, translation, rows, weights)
    members = _members(rows, weights, rotation.shape[1])
    for _ in range(2):
        for joint, (at, slot) in enumerate(members):
            if joint and len(at):
                w = weights[at, slot][:, None]
                own = left[:, at] + w * carried(points[at], rotation[:, joint], translation[:, joint])
                motion = nearest_rigid_motion(points[at], own / w, w[:, 0] ** 2)
                rotation[:, joint], translation[:, joint] = motion
                left[:, at] = own - w * carried(points[at], *motion)
    return rotation, translation


def _members(
    rows: Int64[np.ndarray, "n 4"], weights: Float64[np.ndarray, "n 4"], count: int
) -> list[tuple[Int64[np.ndarray, " m"], Int64[np.ndarray, " m"]]]:
    """Vertices of each joint, and the slot in which they have it."""
    at, slot = np.nonzero(weights > _CARRIES)
    order = np.argsort(rows[at, slot], kind="stable")
    at, slot = at[order], slot[order]
    edges = np.searchsorted(rows[at, slot], np.arange(count + 1))
    return [(at[a:b], slot[a:b]) for a, b in pairwise(edges.tolist())]


def _weights_of_all(
    points: Float64[np.ndarray, "N 3"],
    coefficients: Complex64[np.ndarray, "N K 3"],
    moving: Bool[np.ndarray, " N"],
    motions: Motions,
    num_frames: int,
    on_progress: OnProgress,
) -> tuple[Int64[np.ndarray, "n 4"], Float64[np.ndarray, "n 4"]]:
    """Weights of every moving vertex for joints that were fitted to some of them."""
    rows, weights = list[Int64[np.ndarray, "m 4"]](), list[Float64[np.ndarray, "m 4"]]()
    parts = np.array_split(np.flatnonzero(moving), -(-int(moving.sum()) // FITTED_VERTICES))
    for number, part in enumerate(parts):
        on_progress(_FIT_SHARE + (_WEIGHTS_SHARE - _FIT_SHARE) * number / len(parts))
        targets = _positions(points, coefficients, part, len(motions[0]), num_frames)
        chosen = skin_weights(points[part], targets, *motions)
        for _ in range(2):
            chosen = skin_weights(points[part], targets, *motions, chosen)
        rows.append(chosen[0])
        weights.append(chosen[1])
    return np.concatenate(rows), np.concatenate(weights)


def _interpolated(motions: Motions, count: int) -> tuple[Float64[np.ndarray, "S B 3 3"], Float64[np.ndarray, "S B 3"]]:
    """The same motions at `count` times of the loop: trigonometric interpolation, turned back into rotations."""
    spread = [np.fft.irfft(_resized(np.fft.rfft(m, axis=0), count), count, axis=0) * (count / len(m)) for m in motions]
    u, _, vt = np.linalg.svd(spread[0])
    return np.asarray(u @ vt), spread[1]


def _resized(bins: np.ndarray, count: int) -> np.ndarray:
    """As many bins as a loop of `count` frames has."""
    num = count // 2 + 1
    return np.concatenate([bins[:num], np.zeros((max(0, num - len(bins)), *bins.shape[1:]), bins.dtype)])


def _used_alone(
    rows: Int64[np.ndarray, "N 4"],
    weights: Float64[np.ndarray, "N 4"],
    rotation: Float64[np.ndarray, "T B 3 3"],
    translation: Float64[np.ndarray, "T B 3"],
) -> tuple[Int64[np.ndarray, "N 4"], Float64[np.ndarray, "T J 3 3"], Float64[np.ndarray, "T J 3"]]:
    """Leave out joints that carry nothing; the root stays."""
    used = np.unique(np.append(rows[weights > 0], 0))
    number = np.zeros(rotation.shape[1], np.int64)
    number[used] = np.arange(len(used))
    return number[rows], rotation[:, used], translation[:, used]


def _places(
    points: Float64[np.ndarray, "N 3"], rows: Int64[np.ndarray, "N 4"], weights: Float64[np.ndarray, "N 4"], count: int
) -> Float64[np.ndarray, "B 3"]:
    """Where a joint stands at rest: the mean of what it carries; the root at the tree's foot."""
    total = np.bincount(rows.ravel(), weights.ravel(), minlength=count)
    sums = [np.bincount(rows.ravel(), (weights * points[:, axis, None]).ravel(), minlength=count) for axis in range(3)]
    places = np.stack(sums, axis=1) / np.maximum(total, 1e-9)[:, None]
    places[0] = [*places[:, :2].mean(axis=0), points[:, 2].min()]
    return np.asarray(places)
