"""Turn modes of a skeleton: how far each bone turns in each mode of the vertices' motion, chained from the ground.

A bone turns by atan |θ| about θ = Re Σ_k θ_k q_k, the rotation to the direction in which a sum of modes would move its
end, so its turn saturates and its length stays. With v the sine of half that angle times its axis, f the feet and a the
parent of bone b, a vertex x with the share s of the parent goes to

    f'_b + R((1 - s) v_b + s v_a) (x - f_b),        f'_b = f'_a + R(v_a) (f_b - f_a).

θ_k are the least squares of the vertices' modes in the linear motion, with a price on what neighbours turn apart and
on the stretch of the mesh's edges: stretch of first order grows with the wind. In a wind that turned by α, the swing
θ × d of a bone of direction d turns by α; so what edges grow in a wind from the side has a price too. The motion's own
loop is then played, and what is missing in its K frequencies is fitted and added, `ROUNDS` times; a step after which
more is missing is taken back and halved, so no fit runs away.
"""

from dataclasses import dataclass

import numpy as np
import scipy.sparse
from jaxtyping import Complex64, Complex128, Float32, Float64, Int, Int32

from dynamictree.devoxelize.symmetric_factor import SymmetricFactor, factored
from dynamictree.mesh import TriangleMesh, edges_of
from dynamictree.modal.turn_skeleton import FINENESS, GROUND, TurnSkeleton
from dynamictree.spectrum import iter_motion

ROUNDS = 4
"""A fifth gains less than a tenth of the error."""
FRAMES_A_FREQUENCY = 3
_APART = 1.0  # price of a bone's turn against its parent's, as that of moving a vertex at its end
_APART_BESIDE = 3.0  # likewise, against another bone that edges join it to, as in a crown that is one surface
_STRETCH = 5000.0  # price of edges that grow by their own lengths, as that of moving as many vertices by a voxel
_FROM_SIDE = 0.1  # of it in a wind at right angles to the motion's: sin² of how far the direction turns, 18°
_SHORTEST_EDGE = 0.25  # in voxels; shorter edges cost no more
_CHAINED = 1e6  # price of leaving the parent, as that of moving a vertex
_QUARTER = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 0.0]])  # of a turn about the vertical


def turn_modes(
    skeleton: TurnSkeleton,
    mesh: TriangleMesh,
    coefficients: Complex64[np.ndarray, "N K 3"],
    num_frames: int,
) -> Complex64[np.ndarray, "B K 3"]:
    """Turn modes [rad] for modes of the mesh's vertices [m]; `num_frames` is T of the spectrum."""
    fit = _fit(skeleton, mesh)
    num_frequencies = coefficients.shape[1]
    wanted = fit.pull @ _by_axis(coefficients)  # [9B, K]
    phases = np.arange(FRAMES_A_FREQUENCY * num_frequencies) / (FRAMES_A_FREQUENCY * num_frequencies)
    solution, step = np.zeros(wanted.shape, np.complex128), fit.solve(wanted)
    size = _energy(wanted, step)
    for _ in range(ROUNDS):
        tried = solution + step
        frames = [
            fit.pull @ posed(skeleton, mesh.vertices, theta).ravel()
            for theta in iter_motion(_turns(tried), phases, num_frames)
        ]
        reached = np.fft.rfft(np.stack(frames), axis=0, norm="forward")[:num_frequencies].T  # [9B, K]
        missing = wanted - reached - fit.stretch @ tried
        following = fit.solve(missing)
        if _energy(missing, following) < size:
            solution, step, size = tried, following, _energy(missing, following)
        else:
            step = step / 2
    return _turns(solution)


def _energy(force: Complex128[np.ndarray, "U K"], step: Complex128[np.ndarray, "U K"]) -> float:
    """How much a step gains in the linear problem: what is still missing of the motion, squared."""
    return float(np.einsum("uk,uk->", force.conj(), step).real)


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
    """Least squares of the linear motion in U = 9B unknowns: displacements of feet, turns, and feet in a side wind."""

    pull: scipy.sparse.csr_array  # [U, 3N], from displacements of the vertices to the right-hand side
    stretch: scipy.sparse.csr_array  # [U, U], the price of stretch
    factor: SymmetricFactor

    def solve(self, right: np.ndarray) -> Complex128[np.ndarray, "U K"]:
        real, imaginary = np.split(self.factor.solve(np.concatenate([right.real, right.imag], axis=1)), 2, axis=1)
        return np.asarray(real + 1j * imaginary)


def _turns(solution: Complex128[np.ndarray, "U K"]) -> Complex64[np.ndarray, "B K 3"]:
    turns = np.split(solution, 3)[1].reshape(len(solution) // 9, 3, -1)
    return np.ascontiguousarray(turns.transpose(0, 2, 1)).astype(np.complex64)


def _fit(skeleton: TurnSkeleton, mesh: TriangleMesh) -> _Fit:
    num_bones, vertices = len(skeleton.parent), mesh.vertices
    voxel_m = float(np.ptp(vertices, axis=0).max()) / FINENESS
    edges = edges_of(mesh.faces)
    growth = _growth(vertices, edges, voxel_m)
    same = np.broadcast_to(np.eye(3), (num_bones, 3, 3))
    across = _cross(skeleton.directions.astype(np.float64))
    moves, chain = _linear(skeleton, vertices, 0, same)
    side_moves, side_chain = _linear(skeleton, vertices, 2, -across @ _QUARTER @ across)
    along, aside = growth @ moves, growth @ side_moves
    price = _STRETCH * len(vertices) / max(len(edges), 1)
    stretch = price * (along.T @ along + _FROM_SIDE * (aside.T @ aside))
    apart = _apart(skeleton, edges, voxel_m)
    still = np.zeros(9 * num_bones)
    still[3 * (num_bones + GROUND) : 3 * (num_bones + GROUND + 1)] = _CHAINED
    pull = moves.T.tocsr()
    chained = _CHAINED * (chain.T @ chain + side_chain.T @ side_chain)
    system = pull @ moves + chained + apart.T @ apart + stretch + scipy.sparse.diags_array(still)
    return _Fit(pull=pull, stretch=stretch.tocsr(), factor=factored(system.tocsc()))


def _linear(
    skeleton: TurnSkeleton, vertices: Float32[np.ndarray, "N 3"], feet: int, swing: Float64[np.ndarray, "B 3 3"]
) -> tuple[scipy.sparse.csr_array, scipy.sparse.csr_array]:
    """Displacements of the vertices [m] where each θ is `swing` θ, and what feet leave their parents by [m].

    `feet` is the block of the unknowns that has the displacements of the feet.
    """
    num_bones, bone, above = len(skeleton.parent), skeleton.bone, np.maximum(skeleton.parent, 0)
    share = skeleton.parent_share[:, None, None].astype(np.float64)
    foot = skeleton.foot_m.astype(np.float64)
    rows, each, one = np.arange(len(vertices)), np.arange(num_bones), np.eye(3)
    across = _cross(vertices - foot[bone])
    moves = _blocks(
        (len(vertices), num_bones),
        (rows, feet * num_bones + bone, np.broadcast_to(one, across.shape)),
        (rows, num_bones + bone, -(1 - share) * across @ swing[bone]),
        (rows, num_bones + above[bone], -share * across @ swing[above[bone]]),
    )
    has_parent = (skeleton.parent >= 0)[:, None, None].astype(np.float64)
    chain = _blocks(
        (num_bones, num_bones),
        (each, feet * num_bones + each, np.broadcast_to(one, swing.shape)),
        (each, feet * num_bones + above, -has_parent * one),
        (each, num_bones + above, has_parent * _cross(foot - foot[above]) @ swing[above]),
    )
    return moves, chain


def _apart(skeleton: TurnSkeleton, edges: Int32[np.ndarray, "E 2"], voxel_m: float) -> scipy.sparse.csr_array:
    """What neighbours turn apart times the length of the shorter bone, weighted [m]; 9B columns."""
    num_bones, parent = len(skeleton.parent), skeleton.parent
    joined = np.unique(np.sort(skeleton.bone[edges], axis=1), axis=0)
    first, second = joined[(parent[joined[:, 0]] != joined[:, 1]) & (parent[joined[:, 1]] != joined[:, 0])].T
    child = np.arange(1, num_bones)
    one, other = np.concatenate([child, first]), np.concatenate([parent[1:], second])
    price = np.repeat([_APART, _APART_BESIDE], [len(child), len(first)])
    length = (skeleton.reach_m.astype(np.float64) ** 2).sum(axis=1)
    lever_m = np.sqrt(price * (np.minimum(length[one], length[other]) + voxel_m**2))[:, None, None] * np.eye(3)
    rows = np.arange(len(one))
    return _blocks((len(one), num_bones), (rows, num_bones + one, lever_m), (rows, num_bones + other, -lever_m))


def _growth(
    vertices: Float32[np.ndarray, "N 3"], edges: Int32[np.ndarray, "E 2"], voxel_m: float
) -> scipy.sparse.csr_array:
    """From displacements [m] to first-order growth of the edges, as a share of a length, in voxels [E, 3N]."""
    across = (vertices[edges[:, 0]] - vertices[edges[:, 1]]).astype(np.float64)
    length = np.linalg.norm(across, axis=1)
    edges, across, length = edges[length > 0], across[length > 0], length[length > 0]
    values = across * (voxel_m / (length * np.maximum(length, _SHORTEST_EDGE * voxel_m)))[:, None]
    columns = 3 * edges[:, :, None] + np.arange(3)  # [E, 2, 3]
    ends = 6 * np.arange(len(edges) + 1)
    signed = np.stack([values, -values], axis=1)
    return scipy.sparse.csr_array((signed.ravel(), columns.ravel(), ends), shape=(len(edges), 3 * len(vertices)))


def _blocks(
    shape: tuple[int, int], *blocks: tuple[Int[np.ndarray, " n"], Int[np.ndarray, " n"], Float64[np.ndarray, "n 3 3"]]
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


def _by_axis(coefficients: Complex64[np.ndarray, "N K 3"]) -> np.ndarray:
    """Rows of x, y and z of each vertex [3N, K]."""
    return np.ascontiguousarray(coefficients.transpose(0, 2, 1)).reshape(3 * len(coefficients), -1)
