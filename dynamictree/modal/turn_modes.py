"""Turn modes of a skeleton: how far each bone turns in each mode of the vertices' motion, chained from the ground.

A bone turns by atan |θ| about θ = Re Σ_k θ_k q_k, the rotation to the direction in which a sum of modes would move its
end, so its turn saturates and its length stays. With v the sine of half that angle times its axis, f the feet and a the
parent of bone b, a vertex x with the share s of the parent goes to

    f'_b + R((1 - s) v_b + s v_a) (x - f_b),        f'_b = f'_a + R(v_a) (f_b - f_a).

θ_k are the least squares of the vertices' modes in the linear motion, with a price on what neighbours turn apart. The
motion's own loop is then played, and what is missing in its K frequencies is fitted and added, `ROUNDS` times.
"""

from dataclasses import dataclass

import numpy as np
import scipy.sparse
from jaxtyping import Complex64, Float32, Float64, Int

from dynamictree.devoxelize.symmetric_factor import SymmetricFactor, factored
from dynamictree.modal.turn_skeleton import FINENESS, GROUND, TurnSkeleton
from dynamictree.spectrum import iter_motion

ROUNDS = 3
"""A fourth gains less than a tenth of the error."""
FRAMES_A_FREQUENCY = 3
_APART = 1.0  # price of a bone's turn against its parent's, as that of moving a vertex at its end
_CHAINED = 1e6  # price of leaving the parent, likewise


def turn_modes(
    skeleton: TurnSkeleton,
    vertices: Float32[np.ndarray, "N 3"],
    coefficients: Complex64[np.ndarray, "N K 3"],
    num_frames: int,
) -> Complex64[np.ndarray, "B K 3"]:
    """Turn modes [rad] for modes of the vertices [m]; `num_frames` is T of the spectrum."""
    fit = _fit(skeleton, vertices)
    num_frequencies = coefficients.shape[1]
    wanted = fit.pull @ _by_axis(coefficients)  # [6B, K]
    turns = fit.turns(wanted)
    phases = np.arange(FRAMES_A_FREQUENCY * num_frequencies) / (FRAMES_A_FREQUENCY * num_frequencies)
    for _ in range(ROUNDS):
        frames = [
            fit.pull @ posed(skeleton, vertices, theta).ravel() for theta in iter_motion(turns, phases, num_frames)
        ]
        reached = np.fft.rfft(np.stack(frames), axis=0, norm="forward")[:num_frequencies].T  # [6B, K]
        turns = turns + fit.turns(wanted - reached)
    return turns


def posed(
    skeleton: TurnSkeleton, vertices: Float32[np.ndarray, "N 3"], theta: Float32[np.ndarray, "B 3"]
) -> Float64[np.ndarray, "N 3"]:
    """Displacement of the vertices where the bones turn by these θ [m]."""
    half = half_turns(theta.astype(np.float64))
    above, foot = np.maximum(skeleton.parent, 0), skeleton.foot_m.astype(np.float64)
    arm = foot - foot[above]
    moved = turned(half[above], arm) - arm
    for level in skeleton.levels:
        moved[level] += moved[above[level]]
    arms = vertices - foot[skeleton.bone]
    share = skeleton.parent_share[:, None].astype(np.float64)
    own = (1 - share) * half[skeleton.bone] + share * half[above[skeleton.bone]]
    return np.asarray(moved[skeleton.bone] + turned(own, arms) - arms)


def half_turns(theta: Float64[np.ndarray, "B 3"]) -> Float64[np.ndarray, "B 3"]:
    """Axis times the sine of half the angle, for turns by atan |θ| about θ."""
    cosine = 1 / np.sqrt(1 + (theta**2).sum(axis=1, keepdims=True))
    return np.asarray(theta * cosine / np.sqrt(2 + 2 * cosine))


def turned(half: Float64[np.ndarray, "n 3"], arm: Float64[np.ndarray, "n 3"]) -> Float64[np.ndarray, "n 3"]:
    """Vectors after turns as `half_turns` gives them."""
    real = np.sqrt(1 - (half**2).sum(axis=1, keepdims=True))
    return np.asarray(arm + 2 * np.cross(half, np.cross(half, arm) + real * arm))


@dataclass(frozen=True, kw_only=True)
class _Fit:
    """Least squares of the linear motion in 6B unknowns: displacements of feet, then turns."""

    pull: scipy.sparse.csr_array  # [6B, 3N], from displacements of the vertices to the right-hand side
    factor: SymmetricFactor

    def turns(self, right: np.ndarray) -> Complex64[np.ndarray, "B K 3"]:
        solved = self.factor.solve(np.concatenate([right.real, right.imag], axis=1))
        solved = solved[len(solved) // 2 :].reshape(len(solved) // 6, 3, 2, -1)  # [B, 3, 2, K]
        turns = (solved[:, :, 0] + 1j * solved[:, :, 1]).transpose(0, 2, 1)
        return np.ascontiguousarray(turns).astype(np.complex64)


def _fit(skeleton: TurnSkeleton, vertices: Float32[np.ndarray, "N 3"]) -> _Fit:
    num_bones = len(skeleton.parent)
    bone, above = skeleton.bone, np.maximum(skeleton.parent, 0)
    share = skeleton.parent_share[:, None, None].astype(np.float64)
    foot = skeleton.foot_m.astype(np.float64)
    arms, rows = vertices - foot[bone], np.arange(len(vertices))
    moves = _blocks(
        (len(vertices), num_bones),
        (rows, bone, np.broadcast_to(np.eye(3), (len(rows), 3, 3))),
        (rows, num_bones + bone, -(1 - share) * _cross(arms)),
        (rows, num_bones + above[bone], -share * _cross(arms)),
    )
    each = np.arange(num_bones)
    one = np.broadcast_to(np.eye(3), (num_bones, 3, 3))
    has_parent = (skeleton.parent >= 0)[:, None, None].astype(np.float64)
    chain = _blocks(
        (num_bones, num_bones),
        (each, each, one),
        (each, above, -has_parent * one),
        (each, num_bones + above, has_parent * _cross(foot - foot[above])),
    )
    voxel_m = float(np.ptp(vertices, axis=0).max()) / FINENESS
    lever_m = np.sqrt((skeleton.reach_m.astype(np.float64) ** 2).sum(axis=1) + voxel_m**2)[:, None, None]
    apart = _blocks(
        (num_bones, num_bones),
        (each, num_bones + each, lever_m * one),
        (each, num_bones + above, -lever_m * has_parent * one),
    )
    still = np.zeros(6 * num_bones)
    still[3 * (num_bones + GROUND) : 3 * (num_bones + GROUND + 1)] = _CHAINED
    pull = moves.T.tocsr()
    system = pull @ moves + _CHAINED * (chain.T @ chain) + _APART * (apart.T @ apart) + scipy.sparse.diags_array(still)
    return _Fit(pull=pull, factor=factored(system.tocsc()))


def _blocks(
    shape: tuple[int, int], *blocks: tuple[Int[np.ndarray, " n"], Int[np.ndarray, " n"], Float64[np.ndarray, "n 3 3"]]
) -> scipy.sparse.csr_array:
    """Sparse matrix [3 rows, 6 bones] of 3 x 3 blocks: row, column and values of each."""
    row, column = np.mgrid[0:3, 0:3]
    rows = np.concatenate([(3 * r[:, None, None] + row).ravel() for r, _, _ in blocks])
    columns = np.concatenate([(3 * c[:, None, None] + column).ravel() for _, c, _ in blocks])
    values = np.concatenate([v.ravel() for _, _, v in blocks])
    return scipy.sparse.csr_array((values, (rows, columns)), shape=(3 * shape[0], 6 * shape[1]))


def _cross(vectors: Float64[np.ndarray, "n 3"]) -> Float64[np.ndarray, "n 3 3"]:
    """Matrices of the cross products v x."""
    x, y, z = vectors.T
    zero = np.zeros(len(vectors))
    return np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=1).reshape(-1, 3, 3)


def _by_axis(coefficients: Complex64[np.ndarray, "N K 3"]) -> np.ndarray:
    """Rows of x, y and z of each vertex [3N, K]."""
    return np.ascontiguousarray(coefficients.transpose(0, 2, 1)).reshape(3 * len(coefficients), -1)
