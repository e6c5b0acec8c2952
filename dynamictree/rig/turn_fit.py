"""Fit how the bones turn to a motion of voxels: least squares over the loop, with prices.

Wanted are K frequencies of each voxel's mean over the surface inside. So that what the voxels do not tell stays quiet,
a bone's turn against its parent's has a price, and so have edges of the mesh that grow, in the motion's own wind and in
one from the side: in a wind that turned by α, the swing θ × d of a bone of direction d turns by α.

Gauss-Newton steps: the mean pose alone first, then all frequencies, linearised around it. The rig's own loop is played
and what is missing in its K frequencies is fitted. A step turns no bone by more than `MOST_STEP_RAD`, is shortened
until it lowers the cost, and is the last one if none does, so no fit runs away.
"""

from dataclasses import dataclass
from functools import partial

import numpy as np
import scipy.sparse
from jaxtyping import Complex64, Complex128, Float32, Float64, Int, Int32

from dynamictree.devoxelize.symmetric_factor import SymmetricFactor, factored
from dynamictree.rig.pose import GROUND, Poses, Skeleton, Weights, poses
from dynamictree.spectrum import bin_weights, iter_motion

APART = 0.2
"""Price of a bone's turn against its parent's, as that of moving a voxel at its end by as much. Measured on six grown
trees (docs/decisions/modal.md): 1 loses flutter, 0.05 turns what no voxel tells."""
APART_BESIDE = 3.0
"""Likewise, against another bone that edges join it to, as in a crown that is one surface."""
STRETCH = 500.0
"""Price of edges that grow by their own lengths, as that of moving as many voxels by a voxel: at 5000, a shrub in a
storm is off by 12 % and not 7 %."""
IN_SURFACE = 10.0
"""Times as much in a crown that is one surface: it has no cards, which turn at no price, and stretched by 22 %."""
FROM_SIDE = 0.1
"""Of it in a wind at right angles to the motion's: sin² of how far the direction turns, 18°."""
MEAN_ROUNDS, ROUNDS = 5, 8
LEAST_GAIN = 0.01  # of the cost: a step that gains less is the last
MOST_STEP_RAD = 0.3
STEP_LENGTHS = (1.0, 0.5, 0.25)  # tried in this order
MOST_EDGES = 60_000  # of a larger mesh, evenly chosen: stretch is a mean
FRAMES_A_FREQUENCY = 3  # two would do, were there nothing above the K frequencies
_SHORTEST_EDGE = 0.25  # in voxels; shorter edges cost no more
_CHAINED = 1e6  # price of leaving the parent, as that of moving a voxel
_FIXED = 1e10  # price of a turn of the ground
_ANCHOR = 1e-9  # keeps the system definite where no voxel tells of a bone
_QUARTER = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 0.0]])  # of a turn about the vertical

Solution = Complex128[np.ndarray, "U K"]
"""U = 9B unknowns in blocks of 3B: displacements of feet, turns, and feet in a side wind."""


@dataclass(frozen=True, kw_only=True)
class Target:
    """N points that the bones carry, edges between them, and the motion of V voxels that are means of them."""

    points: Float32[np.ndarray, "N 3"]
    edges: Int32[np.ndarray, "E 2"]
    mean: scipy.sparse.csr_array  # [V, N], rows sum to 1
    coefficients: Complex64[np.ndarray, "V K 3"]  # [m]
    num_frames: int  # T of the spectrum
    voxel_m: float


def fit_turns(skeleton: Skeleton, weights: Weights, target: Target) -> Complex64[np.ndarray, "B K 3"]:
    """Turn modes [rad], in the spectrum's convention, for the bones that carry the target's points."""
    num_bones, num_frequencies = len(skeleton), target.coefficients.shape[1]
    places = _placing(skeleton, weights, target.points)
    problem = _Problem(skeleton, weights, target, places)
    mean = _descended(problem, np.zeros((9 * num_bones, 1), np.complex128), MEAN_ROUNDS)
    solution = np.zeros((9 * num_bones, num_frequencies), np.complex128)
    solution[:, :1] = mean
    if num_frequencies > 1:
        problem = _Problem(skeleton, weights, target, places, about=_turns(mean)[:, 0].real.astype(np.float64))
        solution = _descended(problem, solution, ROUNDS)
    return _turns(solution)


def _descended(problem: "_Problem", solution: Solution, rounds: int) -> Solution:
    now = problem.state(solution)
    for _ in range(rounds):
        step = problem.step(solution, now)
        for length in STEP_LENGTHS:
            tried = problem.with_side_feet(solution + length * step)
            then = problem.state(tried)
            if then.cost < now.cost:
                break
        else:
            return solution
        gain, solution, now = now.cost - then.cost, tried, then
        if gain < LEAST_GAIN * now.cost:
            break
    return solution


@dataclass(frozen=True, kw_only=True)
class _State:
    """What a solution leaves: of the voxels' motion, of the edges' lengths, and what it costs."""

    missing: Complex128[np.ndarray, "V3 K"]
    growth: Complex128[np.ndarray, "E K"]
    cost: float


class _Problem:
    """Least squares linearised around one pose. Edges count as growth times a voxel over their length."""

    def __init__(
        self,
        skeleton: Skeleton,
        weights: Weights,
        target: Target,
        placing: scipy.sparse.csr_array,
        about: Float64[np.ndarray, "B 3"] | None = None,
    ) -> None:
        self.skeleton, self.target = skeleton, target
        num_bones = len(skeleton)
        theta = np.zeros((num_bones, 3)) if about is None else about
        rotation = poses(skeleton, theta[None].astype(np.float32))
        self.means = (target.mean @ placing).tocsr()  # [V, 4B]
        self.rest = target.mean @ target.points.astype(np.float64)
        self.wanted = np.ascontiguousarray(target.coefficients.transpose(0, 2, 1)).reshape(3 * len(self.rest), -1)
        ends, self.length, self.scale = _edge_ends(skeleton, weights, target)
        self.vectors = (ends @ placing).tocsr()  # [E, 4B]
        self.price = STRETCH * len(self.rest) / max(len(target.edges[:: _stride(target)]), 1)

        turning = _turning(theta)
        moves, chain = _linear(skeleton, self.means, rotation, feet=0, swing=turning)
        growth, _ = _linear(skeleton, self.vectors, rotation, feet=0, swing=turning)
        self.along = (self._lengthening(rotation) @ growth).tocsr()
        across = _cross(skeleton.directions.astype(np.float64))
        self.side_swing = -across @ _QUARTER @ across
        at_rest = poses(skeleton, np.zeros((1, num_bones, 3), np.float32))
        side_growth, side_chain = _linear(skeleton, self.vectors, at_rest, feet=2, swing=self.side_swing)
        aside = self._lengthening(at_rest) @ side_growth
        apart = _apart(skeleton, weights, target)
        self.prior = (self.price * FROM_SIDE * (aside.T @ aside) + apart.T @ apart).tocsr()
        self.pull = moves.T.tocsr()
        fixed = np.full(9 * num_bones, _ANCHOR)
        fixed[3 * (num_bones + GROUND) : 3 * (num_bones + GROUND + 1)] = _FIXED
        chained = _CHAINED * (chain.T @ chain + side_chain.T @ side_chain)
        system = self.pull @ moves + self.price * (self.along.T @ self.along) + self.prior + chained
        self.factor: SymmetricFactor = factored((system + scipy.sparse.diags_array(fixed)).tocsc())

    def _lengthening(self, pose: Poses) -> scipy.sparse.csr_array:
        """From displacements of edge vectors [m] to weighted growth [E, 3E]."""
        vectors = self.vectors @ _stacked(pose)[:, 0]
        along = vectors * (self.scale / np.maximum(np.linalg.norm(vectors, axis=1), 1e-12))[:, None]
        count = len(along)
        ends = 3 * np.arange(count + 1)
        return scipy.sparse.csr_array((along.ravel(), np.arange(3 * count), ends), shape=(count, 3 * count))

    def state(self, solution: Solution) -> _State:
        """Play a loop of the rig, and compare its frequencies."""
        num_frequencies = solution.shape[1]
        num_frames = FRAMES_A_FREQUENCY * num_frequencies if num_frequencies > 1 else 1
        phases = np.arange(num_frames) / num_frames
        theta = np.stack(list(iter_motion(_turns(solution), phases, self.target.num_frames)))
        stacked = _stacked(poses(self.skeleton, theta))  # [4B, F, 3]
        flat = stacked.reshape(len(stacked), -1)
        moved = (self.means @ flat).reshape(len(self.rest), num_frames, 3) - self.rest[:, None]
        vectors = (self.vectors @ flat).reshape(len(self.length), num_frames, 3)
        grown = (np.sqrt(np.einsum("efc,efc->ef", vectors, vectors)) - self.length[:, None]) * self.scale[:, None]
        bins = partial(_bins, num_frequencies=num_frequencies)
        missing = self.wanted[:, :num_frequencies] - bins(moved)
        growth = bins(grown[:, :, None])
        often = bin_weights(num_frequencies, self.target.num_frames).astype(np.float64)
        lost = float((np.abs(missing) ** 2 @ often).sum())
        stretched = self.price * float((np.abs(growth) ** 2 @ often).sum())
        priced = float(((solution.conj() * (self.prior @ solution)).real @ often).sum())
        return _State(missing=missing, growth=growth, cost=lost + stretched + priced)

    def step(self, solution: Solution, state: _State) -> Solution:
        """The step to the least linearised cost, with no bone's turn above `MOST_STEP_RAD`."""
        downhill = self.pull @ state.missing - self.price * (self.along.T @ state.growth) - self.prior @ solution
        real, imaginary = np.split(self.factor.solve(np.concatenate([downhill.real, downhill.imag], axis=1)), 2, axis=1)
        step = np.asarray(real + 1j * imaginary)
        often = bin_weights(step.shape[1], self.target.num_frames)
        turns = np.split(step, 3)[1].reshape(len(self.skeleton), 3, -1)
        size = np.sqrt((np.abs(turns) ** 2 @ often).sum(axis=1))
        turns *= np.minimum(1, MOST_STEP_RAD / np.maximum(size, 1e-12))[:, None, None]
        turns[GROUND] = 0
        return step

    def with_side_feet(self, solution: Solution) -> Solution:
        """The same turns, with the feet that a side wind then moves."""
        skeleton, above = self.skeleton, self.skeleton.above
        foot = skeleton.foot_m.astype(np.float64)
        turns = np.split(solution, 3)[1].reshape(len(skeleton), 3, -1)
        moved = -_cross(foot - foot[above]) @ self.side_swing[above] @ turns[above]
        for level in skeleton.levels:
            moved[level] += moved[above[level]]
        solution[2 * len(solution) // 3 :] = moved.reshape(len(solution) // 3, -1)
        return solution


def _turns(solution: Solution) -> Complex64[np.ndarray, "B K 3"]:
    turns = np.split(solution, 3)[1].reshape(len(solution) // 9, 3, -1)
    return np.ascontiguousarray(turns.transpose(0, 2, 1)).astype(np.complex64)


def _bins(frames: Float64[np.ndarray, "n F c"], num_frequencies: int) -> Complex128[np.ndarray, "nc K"]:
    spectrum = np.fft.rfft(frames, axis=1, norm="forward")[:, :num_frequencies]
    return np.asarray(spectrum.transpose(0, 2, 1).reshape(-1, spectrum.shape[1]))


def _stride(target: Target) -> int:
    return -(-max(len(target.edges), 1) // MOST_EDGES)


def _placing(skeleton: Skeleton, weights: Weights, points: Float32[np.ndarray, "N 3"]) -> scipy.sparse.csr_array:
    """Places of points as a product with `_stacked` poses [N, 4B]: the shares, then the shares times each arm."""
    num_bones, (num_points, width) = len(skeleton), weights.rows.shape
    arm = points[:, None].astype(np.float64) - skeleton.foot_m[weights.rows]  # [N, W, 3]
    values = np.concatenate([np.ones((num_points, width, 1)), arm], axis=2) * weights.shares[:, :, None]
    columns = weights.rows[:, :, None] + num_bones * np.arange(4)
    used = np.broadcast_to(weights.shares[:, :, None] > 0, values.shape)
    row = np.repeat(np.arange(num_points), used.sum(axis=(1, 2)))
    return scipy.sparse.csr_array((values[used], (row, columns[used])), shape=(num_points, 4 * num_bones))


def _stacked(pose: Poses) -> Float64[np.ndarray, "B4 T 3"]:
    """Feet, then columns of the rotations, which `_placing` multiplies."""
    parts = [pose.place_m, *(pose.rotation[..., column] for column in range(3))]
    return np.concatenate([part.transpose(1, 0, 2) for part in parts])


def _edge_ends(
    skeleton: Skeleton, weights: Weights, target: Target
) -> tuple[scipy.sparse.csr_array, Float64[np.ndarray, " E"], Float64[np.ndarray, " E"]]:
    """Differences [E, N] of the edges that can grow; their lengths [m], and weights of their growth [1/m · m]."""
    edges = target.edges[:: _stride(target)]
    length = np.linalg.norm(target.points[edges[:, 0]].astype(np.float64) - target.points[edges[:, 1]], axis=1)
    one, other = weights.rows[edges[:, 0]], weights.rows[edges[:, 1]]
    single = (weights.shares[edges, 0] == 1).all(axis=1)
    can_grow = (length > 0) & ~(single & (one[:, 0] == other[:, 0]))
    edges, length = edges[can_grow], length[can_grow]
    dear = np.sqrt(np.where(skeleton.in_surface[weights.rows[edges, 0]].all(axis=1), IN_SURFACE, 1))
    scale = dear * target.voxel_m / np.maximum(length, _SHORTEST_EDGE * target.voxel_m)
    signs = np.tile([1.0, -1.0], len(edges))
    shape = (len(edges), len(target.points))
    return scipy.sparse.csr_array((signs, edges.ravel(), 2 * np.arange(len(edges) + 1)), shape=shape), length, scale


def _turning(theta: Float64[np.ndarray, "B 3"]) -> Float64[np.ndarray, "B 3 3"]:
    """From a change of θ to the small rotation [rad] that R(θ) is turned by."""
    cosine = (1 / np.sqrt(1 + (theta**2).sum(axis=1)))[:, None, None]
    outer = theta[:, :, None] * theta[:, None, :]
    return np.asarray(cosine * np.eye(3) - cosine**3 / (1 + cosine) * outer + cosine**2 / (1 + cosine) * _cross(theta))


def _linear(
    skeleton: Skeleton, placing: scipy.sparse.csr_array, pose: Poses, *, feet: int, swing: Float64[np.ndarray, "B 3 3"]
) -> tuple[scipy.sparse.csr_array, scipy.sparse.csr_array]:
    """Displacements of the rows of `placing` [m] under small turns `swing` θ, and what feet leave their parents by [m].

    `feet` is the block of the unknowns that has the displacements of the feet.
    """
    num_bones, above = len(skeleton), skeleton.above
    rotation = pose.rotation[0]
    carries = placing[:, :num_bones].tocoo()
    arms = placing[:, num_bones:].tocoo()
    column, bone = np.divmod(arms.col, num_bones)
    keys, pair = np.unique(arms.row * np.int64(num_bones) + bone, return_inverse=True)
    row, bone = np.divmod(keys, num_bones)
    turned = rotation[bone[pair], :, column] * arms.data[:, None]
    arm = np.stack([np.bincount(pair, turned[:, i], len(keys)) for i in range(3)], axis=1)
    one = np.eye(3)
    moves = _blocks(
        (placing.shape[0], num_bones),
        (carries.row, feet * num_bones + carries.col, carries.data[:, None, None] * one),
        (row, num_bones + bone, -_cross(arm) @ swing[bone]),
    )
    foot, each = skeleton.foot_m.astype(np.float64), np.arange(num_bones)
    between = np.einsum("bij,bj->bi", rotation[above], foot - foot[above])
    has_parent = (skeleton.parent >= 0)[:, None, None].astype(np.float64)
    chain = _blocks(
        (num_bones, num_bones),
        (each, feet * num_bones + each, np.broadcast_to(one, swing.shape)),
        (each, feet * num_bones + above, -has_parent * one),
        (each, num_bones + above, has_parent * _cross(between) @ swing[above]),
    )
    return moves, chain


def _apart(skeleton: Skeleton, weights: Weights, target: Target) -> scipy.sparse.csr_array:
    """What neighbours turn apart times the length of the shorter bone, weighted [m]; 9B columns."""
    num_bones, parent = len(skeleton), skeleton.parent
    joined = np.unique(np.sort(weights.rows[target.edges, 0], axis=1), axis=0)
    first, second = joined[
        (joined[:, 0] != joined[:, 1]) & (parent[joined[:, 0]] != joined[:, 1]) & (parent[joined[:, 1]] != joined[:, 0])
    ].T
    child = np.arange(1, num_bones)
    one, other = np.concatenate([child, first]), np.concatenate([parent[1:], second])
    price = np.repeat([APART, APART_BESIDE], [len(child), len(first)])
    length = (skeleton.reach_m.astype(np.float64) ** 2).sum(axis=1)
    lever_m = np.sqrt(price * (np.minimum(length[one], length[other]) + target.voxel_m**2))[:, None, None] * np.eye(3)
    rows = np.arange(len(one))
    return _blocks((len(one), num_bones), (rows, num_bones + one, lever_m), (rows, num_bones + other, -lever_m))


def _blocks(
    shape: tuple[int, int], *blocks: tuple[Int[np.ndarray, " _"], Int[np.ndarray, " _"], Float64[np.ndarray, "_ 3 3"]]
) -> scipy.sparse.csr_array:
    """Sparse matrix [3 rows, 9 bones] of 3 x 3 blocks: row, column and values of each."""
    row, column = np.mgrid[0:3, 0:3]
    rows = np.concatenate([(3 * r[:, None, None] + row).ravel() for r, _, _ in blocks])
    columns = np.concatenate([(3 * c[:, None, None] + column).ravel() for _, c, _ in blocks])
    values = np.concatenate([v.ravel() for _, _, v in blocks])
    return scipy.sparse.csr_array((values, (rows, columns)), shape=(3 * shape[0], 9 * shape[1]))


def _cross(vectors: Float64[np.ndarray, "n 3"]) -> Float64[np.ndarray, "n 3 3"]:
    """Matrices of the cross products v x."""
    x, y, z = vectors.T
    zero = np.zeros(len(vectors))
    return np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=1).reshape(-1, 3, 3)
