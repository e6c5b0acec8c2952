"""Fit the bones' rotations to a motion of voxels: regularized least squares over the loop.

The data are K frequencies of each voxel's mean over the surface inside. To regularize rotations that the voxels do not
determine, a bone's rotation relative to its parent has a cost, and so have stretched edges of the mesh, in the motion's
own wind and in one from the side: in a wind rotated by α, the swing θ × d of a bone of direction d rotates by α.

Each card, and all bending bones together, should move with their voxels, plus the means' residuals:
Σ_v Σ_b w_vb |x_vb - y_vb|², y_vb = x_vb + residual of voxel v. This bounds the means' squared residuals from above,
with equality where the voxels were last evaluated, so lowering it lowers them (majorization). It does not couple cards
that share a voxel, so memory and time of its factorization grow only with their number.

Gauss-Newton steps fit the mean pose first, then all frequencies, linearised around it, and both again at a higher cost
if wood or a crown's surface would break. Each step simulates the rig's loop, and fits the residuals of K frequencies.
It rotates no bone by more than `MAX_STEP_RAD`, and is shortened until it lowers the cost; if none does, it is last.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
import scipy.sparse
import scipy.sparse.linalg
from jaxtyping import Complex64, Float32, Float64

from dynamictree.rig import turn_matrices as matrices
from dynamictree.rig.pose import GROUND, Poses, Skeleton, Weights, poses
from dynamictree.rig.turn_matrices import Target
from dynamictree.spectrum import bin_weights, iter_motion

STRETCH_COST = 500.0
"""Cost of edges that double their length, in units of moving as many voxels by a voxel; with 5000, a shrub in a storm
has an error of 12 % instead of 7 %."""
SIDE_WIND_SHARE = 0.1
"""Share of that cost in a wind perpendicular to the motion's: sin² of the rotation of the direction, 18°."""
MEAN_ROUNDS, ROUNDS = (3, 1, 1), (3, 1, 1, 1, 1)
"""Largest numbers of steps per evaluation of the voxels: for the mean pose, and for all frequencies."""
LEAST_GAIN = 0.01  # relative decrease of the cost below which to stop
MAX_STEP_RAD = 0.3
STEP_LENGTHS = (1.0, 0.5, 0.25)  # tried in this order
FRAMES_PER_FREQUENCY = 3  # two would suffice without motion above the K frequencies
_VOXELS_AT_ONCE = 100_000
_CHAINED = 1e6  # cost of separation from the parent [cost of moving a voxel]
_FIXED = 1e10  # cost of a rotation of the ground
_ANCHOR = 1e-9  # makes the system definite for bones without voxels
_GENERATOR = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 0.0]])  # rotations about the vertical

Solution = Complex64[np.ndarray, "U K"]
"""Displacements of the B feet, rotations, displacements of bending bones' feet in a side wind; three numbers each."""
CostFactors = tuple[Float64[np.ndarray, " B"] | float, Float64[np.ndarray, " E"] | float]  # rotations, edges
Spectra = Complex64[np.ndarray, "B4 3 K"]
"""Feet, then columns of the rotations, minus those at rest; the vector that `matrices.skinning_matrix` multiplies."""


def fit_turns(
    skeleton: Skeleton, weights: Weights, target: Target, report: Callable[[float], None]
) -> Complex64[np.ndarray, "B K 3"]:
    """Fit rotation modes [rad] of the bones that carry the target's points; `report` gets the completed share."""
    voxels = _Voxels(skeleton, weights, target)
    turns = np.zeros((len(skeleton), 1, 3), np.complex64)
    factors: CostFactors = (1.0, 1.0)
    stages = 2 * [(1, MEAN_ROUNDS), (target.coefficients.shape[1], ROUNDS)]
    done, whole = 0, sum(len(rounds) for _, rounds in stages)
    for num_frequencies, rounds in stages:
        problem = _Problem(skeleton, weights, target, voxels, turns[:, 0].real, factors)
        solution = problem.solution(turns[:, :1], num_frequencies)
        now = problem.read(solution, *problem.simulate(solution))
        del solution  # each is as large as the factorization, if most bones are cards
        for number, most in enumerate(rounds):
            done += 1
            report(done / (whole + 1))
            now = problem.read(now.solution, now.stacked, now.growth) if number else now
            for _ in range(most):
                before, now = now.cost, problem.better(now)
                if before - now.cost <= LEAST_GAIN * now.cost:
                    break
        turns = problem.turns(now.solution)
        if num_frequencies > 1 and np.hstack(factors := problem.factors(now.growth)).max() == 1:
            break
        del problem  # frees its factorization, hundreds of megabytes, before the next
    return turns


class _Voxels:
    """Means of the bones' surface in each of V voxels, and their target motion."""

    def __init__(self, skeleton: Skeleton, weights: Weights, target: Target) -> None:
        self.coefficients, self.num_frames, num_bones = target.coefficients, target.num_frames, len(skeleton)
        self.skinning = matrices.skinning_matrix(skeleton, weights, target.points)
        self.means = (target.mean.astype(np.float32) @ self.skinning.astype(np.float32)).tocsr()
        alone = np.arange(num_bones)  # bending bones are fitted together
        alone[weights.rows[(weights.shares > 0) & (weights.shares < 1)]] = GROUND
        # the weight is 1 / energy, or a trunk would compensate its crown's residuals; it is 1 for voxels above the
        # median, and for one-surface crowns, which would tear where they hardly move
        power = (np.abs(self.coefficients) ** 2).sum(axis=2) @ bin_weights(self.coefficients.shape[1], self.num_frames)
        dear = np.clip(np.median(power) / np.maximum(power, 1e-30), 1, 1000)
        dear[target.mean @ skeleton.in_surface[weights.rows[:, 0]] > 0.5] = 1
        self.weight = dear.astype(np.float32)
        self.moments = scipy.sparse.csr_array((4 * num_bones, 4 * num_bones))
        for start in range(0, len(self.coefficients), _VOXELS_AT_ONCE):
            means = self.means[start : start + _VOXELS_AT_ONCE].tocoo()
            column, bone = np.divmod(means.col, num_bones)
            keys, pair = np.unique(means.row * np.int64(num_bones) + alone[bone], return_inverse=True)
            share = np.bincount(pair, np.where(column == 0, means.data, 0), len(keys))
            weight = self.weight[start + means.row]
            scaled = means.data * np.sqrt(weight / np.maximum(share, 1e-12)[pair])
            parts = scipy.sparse.csr_array((scaled, (pair, means.col)), (len(keys), 4 * num_bones))
            self.moments = self.moments + parts.T @ parts

    def read(self, stacked: Spectra) -> tuple[Spectra, float]:
        """Compute the voxels' residuals, summed by each bone's shares, and the sum of their squares [m²]."""
        missed, lost = np.zeros_like(stacked), 0.0
        for start in range(0, len(self.coefficients), _VOXELS_AT_ONCE):
            some = slice(start, start + _VOXELS_AT_ONCE)
            means = scipy.sparse.csr_array(self.means[some])
            missing = self.coefficients[some, : stacked.shape[2]].transpose(0, 2, 1) - _times(means, stacked)
            weighted = self.weight[some, None, None] * missing
            lost += _weighted_product(missing, weighted, self.num_frames)
            missed += _times(means.T, weighted)
        return missed, lost


@dataclass(frozen=True, kw_only=True)
class _State:
    """Loop of a solution, with its cost and the negative gradient of the cost."""

    solution: Solution
    stacked: Spectra  # spectrum of the poses
    growth: Complex64[np.ndarray, "E K"]  # weighted growth of edges
    downhill: Solution
    cost: float


class _Problem:
    """Least squares linearised around one pose. The growth of an edge is weighted by a voxel over its length."""

    def __init__(
        self,
        skeleton: Skeleton,
        weights: Weights,
        target: Target,
        voxels: _Voxels,
        about: Float32[np.ndarray, "B 3"],
        factors: CostFactors,
    ) -> None:
        self.skeleton, self.voxels, num_bones = skeleton, voxels, len(skeleton)
        self._product = partial(_weighted_product, num_frames=voxels.num_frames)
        at_rest, there = (poses(skeleton, theta[None]) for theta in (np.zeros_like(about), about))
        ends, self.length, self.scale = matrices.edge_differences(skeleton, weights, target)
        self.scale = self.scale * np.sqrt(factors[1])
        self.vectors = (ends @ voxels.skinning).tocsr()  # [E, 4B]
        self.price = STRETCH_COST * len(voxels.coefficients) / max(len(target.fitted_edges), 1)
        self.bends = np.zeros(num_bones, np.bool_)
        self.stretches = np.unique(self.vectors.indices % num_bones)  # bones that affect edges
        self.bends[self.stretches] = True
        columns = (self.stretches + num_bones * np.arange(4)[:, None]).ravel()
        self.their_vectors = self.vectors[:, columns]
        for level in reversed(skeleton.levels):
            self.bends[skeleton.above[level][self.bends[level]]] = True

        jacobian = matrices.turn_jacobian(about.astype(np.float64))
        whole = scipy.sparse.eye_array(4 * num_bones).tocsr()
        moves, chain = matrices.linearise(skeleton, whole, there, feet=0, swing=jacobian)
        growth, _ = matrices.linearise(skeleton, self.vectors, there, feet=0, swing=jacobian)
        along = self._lengthening(there) @ growth
        across = matrices.skew(skeleton.directions.astype(np.float64))
        self.side_swing = -across @ _GENERATOR @ across
        side_growth, side_chain = matrices.linearise(skeleton, self.vectors, at_rest, feet=2, swing=self.side_swing)
        aside = self._lengthening(at_rest) @ side_growth
        apart = matrices.coupling(skeleton, weights, target, voxels.means[:, :num_bones].sum(axis=0, dtype=np.float64))
        price = np.ones(apart.shape[0])
        price[: 3 * (num_bones - 1)] = np.repeat(np.broadcast_to(factors[0], num_bones)[1:], 3)  # children are first
        prior = self.price * SIDE_WIND_SHARE * (aside.T @ aside) + apart.T @ scipy.sparse.diags_array(price) @ apart
        fixed = np.full(9 * num_bones, _ANCHOR)
        fixed[3 * (num_bones + GROUND) : 3 * (num_bones + GROUND + 1)] = _FIXED
        side_chain = side_chain[np.repeat(self.bends, 3)]
        chained = _CHAINED * (chain.T @ chain + side_chain.T @ side_chain)
        moments = scipy.sparse.kron(voxels.moments, scipy.sparse.eye_array(3))
        system = moves.T @ moments @ moves + self.price * (along.T @ along) + prior + chained
        used = np.flatnonzero(np.repeat(np.concatenate([np.ones(2 * num_bones, np.bool_), self.bends]), 3))
        system = (system + scipy.sparse.diags_array(fixed)).tocsr()[used][:, used].tocsc()
        self.moves, self.along = (part.tocsr()[:, used].astype(np.float32) for part in (moves, along))
        self.prior = prior.tocsr()[used][:, used].astype(np.float32)
        del moves, growth, along, side_growth, aside, moments, chained, prior  # 150 MB; the factorization takes as much
        self.factor = scipy.sparse.linalg.splu(
            system, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True}
        )

    def _lengthening(self, pose: Poses) -> scipy.sparse.csr_array:
        """Return the matrix from displacements of edge vectors [m] to weighted growth [E, 3E]."""
        vectors = self.vectors @ matrices.stack_poses(pose)[..., 0]
        along = vectors * (self.scale / np.maximum(np.linalg.norm(vectors, axis=1), 1e-12))[:, None]
        count = len(along)
        ends = 3 * np.arange(count + 1)
        return scipy.sparse.csr_array((along.ravel(), np.arange(3 * count), ends), shape=(count, 3 * count))

    def read(self, solution: Solution, stacked: Spectra, growth: Complex64[np.ndarray, "E K"]) -> _State:
        """Set each bone's target from its voxels' residuals in a simulated loop."""
        missed, lost = self.voxels.read(stacked)
        self.goal = _times(self.voxels.moments, stacked)
        self.goal += missed
        self.lost = lost + self._product(stacked, self.goal) + self._product(stacked, missed)
        return self._state(solution, stacked, growth, missed, lost)

    def state(self, solution: Solution) -> _State:
        """Simulate a loop of the rig, and compare its spectrum with the target."""
        stacked, growth = self.simulate(solution)
        missing = _times(self.voxels.moments, stacked)
        np.subtract(self.goal, missing, out=missing)
        lost = self.lost - self._product(stacked, self.goal) - self._product(stacked, missing)
        return self._state(solution, stacked, growth, missing, lost)

    def _state(
        self, solution: Solution, stacked: Spectra, growth: Complex64[np.ndarray, "E K"], missing: Spectra, lost: float
    ) -> _State:
        uphill = _times(self.prior, solution)
        cost = lost + self.price * self._product(growth, growth) + self._product(solution, uphill)
        pull = _times(self.along.T, growth)
        pull *= np.float32(self.price)
        uphill += pull
        del pull
        downhill = _times(self.moves.T, missing.reshape(-1, solution.shape[1]))
        downhill -= uphill
        return _State(solution=solution, stacked=stacked, growth=growth, downhill=downhill, cost=cost)

    def simulate(self, solution: Solution) -> tuple[Spectra, Complex64[np.ndarray, "E K"]]:
        """Simulate a loop; return the spectra of the bones' poses and of the weighted growth of edges."""
        poses_at_once = 500_000  # 50 MB
        num_bones, num_frequencies = len(self.skeleton), solution.shape[1]
        num_frames = FRAMES_PER_FREQUENCY * num_frequencies if num_frequencies > 1 else 1
        frame = np.arange(num_frames)
        wave = np.exp(-2j * np.pi / num_frames * frame[:, None] * np.arange(num_frequencies)) / num_frames
        wave = np.ascontiguousarray(wave.astype(np.complex64)).view(np.float32)
        turns = self.turns(solution)
        stacked = np.zeros((4, 3 * num_bones, 2 * num_frequencies), np.float32)  # feet, then columns of rotations
        growth = np.zeros((len(self.length), 2 * num_frequencies), np.float32)
        for some in np.array_split(frame, -(-num_frames * num_bones // poses_at_once)):
            now = poses(self.skeleton, np.stack(list(iter_motion(turns, some / num_frames, self.voxels.num_frames))))
            theirs = Poses(rotation=now.rotation[:, self.stretches], place_m=now.place_m[:, self.stretches])
            growth += matrices.edge_growth(self.their_vectors, theirs, self.length, self.scale) @ wave[some]
            now.place_m[:] -= self.skeleton.foot_m
            now.rotation[:] -= np.eye(3)
            for part, total in zip((now.place_m, *np.moveaxis(now.rotation, 3, 0)), stacked, strict=True):
                total += part.astype(np.float32).reshape(len(some), -1).T @ wave[some]
        return stacked.view(np.complex64).reshape(4 * num_bones, 3, -1), growth.view(np.complex64)

    def better(self, now: _State) -> _State:
        """Take the longest step that lowers the cost; none if none does."""
        step = self.step(now)
        tried = (self.state(self.with_side_feet(now.solution + np.float32(length) * step)) for length in STEP_LENGTHS)
        return next(filter(lambda then: then.cost < now.cost, tried), now)

    def step(self, state: _State) -> Solution:
        """Compute the step to the minimum of the linearised cost, with rotations limited to `MAX_STEP_RAD`."""
        downhill = state.downhill.view(np.float32)
        step = np.empty_like(downhill)
        for some in np.array_split(np.arange(downhill.shape[1]), 4):  # float64 takes twice the memory
            step[:, some] = self.factor.solve(downhill[:, some].astype(np.float64))
        step = step.view(np.complex64)
        turns = step[3 * len(self.skeleton) : 6 * len(self.skeleton)].reshape(len(self.skeleton), 3, -1)
        size = np.sqrt((np.abs(turns) ** 2 @ bin_weights(step.shape[1], self.voxels.num_frames)).sum(axis=1))
        turns *= np.minimum(1, MAX_STEP_RAD / np.maximum(size, 1e-12))[:, None, None]
        turns[GROUND] = 0
        return step

    def factors(self, growth: Complex64[np.ndarray, "E K"]) -> CostFactors:
        """Return cost factors of rotations and edges, above 1 if one edge in twenty grows by more than `strained`.

        Growth is the loop's root mean square relative to length: wood breaks at 0.01; noise of voxels exceeds that.
        """
        strained, gentle, quiet, most = 0.004, 0.003, 0.0005, 10
        power = np.abs(growth) ** 2 @ bin_weights(growth.shape[1], self.voxels.num_frames)
        square = power / (self.scale * self.length) ** 2
        turns, edges = np.ones(len(self.skeleton)), np.ones(len(square))
        bone, first, width = self.vectors.indices % len(turns), self.vectors.indptr[:-1], np.diff(self.vectors.indptr)
        in_surface = self.skeleton.in_surface[np.maximum.reduceat(bone, first)]
        of_wood, of_surface = square * ~in_surface, square * in_surface
        if len(square) and np.percentile(of_wood, 95) > strained**2:
            bears = bone == np.repeat(np.minimum.reduceat(bone, first), width)
            total, count = (np.bincount(bone, np.repeat(each, width) * ~bears, len(turns)) for each in (of_wood, edges))
            turns = np.maximum(total / np.maximum(count, 1) / quiet**2, 1)
        if len(square) and np.percentile(of_surface, 95) > strained**2:
            edges = np.clip(of_surface / gentle**2, 1, most)
        return turns, edges

    def with_side_feet(self, solution: Solution) -> Solution:
        """Return the solution with the feet's displacements in a side wind computed from its rotations."""
        skeleton, above = self.skeleton, self.skeleton.above
        foot = skeleton.foot_m.astype(np.float64)
        lever = (-matrices.skew(foot - foot[above]) @ self.side_swing[above]).astype(np.float32)
        turns = solution[3 * len(skeleton) : 6 * len(skeleton)].reshape(len(skeleton), 3, -1)
        moved = np.zeros_like(turns)
        for level in skeleton.levels:
            some = level.start + np.flatnonzero(self.bends[level])
            moved[some] = moved[above[some]] + lever[some] @ turns[above[some]]
        solution[6 * len(skeleton) :] = moved[self.bends].reshape(-1, solution.shape[1])
        return solution

    def turns(self, solution: Solution) -> Complex64[np.ndarray, "B K 3"]:
        """Extract the rotations of a solution, in a rig's layout."""
        count = len(self.skeleton)
        return np.ascontiguousarray(solution[3 * count : 6 * count].reshape(count, 3, -1).transpose(0, 2, 1))

    def solution(self, turns: Complex64[np.ndarray, "B L 3"], num_frequencies: int) -> Solution:
        """Create a solution of K frequencies whose first frequencies are the given rotations."""
        count = len(self.skeleton)
        solution = np.zeros((6 * count + 3 * int(self.bends.sum()), num_frequencies), np.complex64)
        solution[3 * count : 6 * count, : turns.shape[1]] = turns.transpose(0, 2, 1).reshape(3 * count, -1)
        return self.with_side_feet(solution)


def _times(
    matrix: scipy.sparse.csr_array | scipy.sparse.csc_array, values: Complex64[np.ndarray, "..."]
) -> Complex64[np.ndarray, "..."]:
    """Multiply a real matrix with complex values."""
    product = matrix.astype(np.float32, copy=False) @ values.reshape(len(values), -1).view(np.float32)
    return np.asarray(product).view(np.complex64).reshape(-1, *values.shape[1:])


def _weighted_product(one: np.ndarray, other: np.ndarray, num_frames: int) -> float:
    """Weighted scalar product of spectra, summed in float64."""
    often = np.repeat(bin_weights(one.shape[-1], num_frames), 2)
    total = np.zeros(len(often))
    matrices.add_products(*(values.reshape(-1, one.shape[-1]).view(np.float32) for values in (one, other)), total)
    return float(total @ often)
