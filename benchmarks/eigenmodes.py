"""Compare pushes by eigenmodes of the voxels, by learned modes and by joints of the rig with beams of the skeleton.

The truth: Euler-Bernoulli beams along the generated skeleton, with its radii and one stiffness, pushed sideways at a
stem's end. The rival needs no training: weights from one generalised eigenproblem of reproducing kernels on the voxels,
an affine handle per weight, and linear elasticity of one material (FreeForm, arXiv 2605.29318). *By radii*: stiffness
from the skeleton's radii, which no user has. *voxels*: the truth, averaged over each voxel. Errors are those of the
response's shape: the sine of the angle between the two displacements of all nodes.
"""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np
import scipy.sparse
import scipy.sparse.linalg
from scipy.spatial import cKDTree

from benchmarks._machine import BRIEF, machine
from benchmarks.modal_locality import on_same_path
from dynamictree import method
from dynamictree.modal.force import Drag, contact_at_voxel, equilibrium, modal_force
from dynamictree.modal.interactive_tree import Answer, ForceGroup, InteractiveTree, Locality
from dynamictree.modal.step import State
from dynamictree.modal.system import ModalSystem, displacement, modal_system
from dynamictree.rig.rig import rig_of
from lab.dataset.sample import make_sample, voxel_spectrum
from lab.dataset.stem_skeleton import Skeleton

TREES = (("round-broadleaf", 7), ("pine", 4), ("shrub", 5))
PLACES = 4 if BRIEF else 30  # stem ends per tree, equally many of each level
KERNELS, HANDLES = (200, 8) if BRIEF else (1000, 40)
POINTS = 4000  # number of points in the sum of the rival's elastic energy
REACH = 3.0  # end of a kernel [radii]
POISSON = 0.3
GROUND = 0.02  # [share of the height]
PULL = 0.01  # pull of joints [share of the height]: small, so that they respond like beams

Push = Callable[[int, np.ndarray], np.ndarray]
"""Maps a voxel and a force on it to the displacement of all voxels, up to a factor [V, 3]."""


def run() -> dict[str, object]:
    rows = {}
    for species, seed in TREES[:1] if BRIEF else TREES:
        rows[species] = _compare(species, seed)
    who = next(iter(rows.values()))["error"]
    return {
        "value": {name: round(float(np.mean([row["error"][name] for row in rows.values()])), 3) for name in who},
        "unit": "sin of the angle between the answer and that of beams, median of places, mean of trees",
        "trees": rows,
        "settings": {"kernels": KERNELS, "handles": HANDLES, "places": PLACES},
        **machine("numpy", "scipy"),
    }


def _compare(species: str, seed: int) -> dict[str, dict[str, float]]:
    sample = make_sample(seed, species)
    stems, voxels = sample.skeleton, method.voxelize(sample.mesh)
    grid, spent = voxels.grid, {}
    near = cKDTree(grid.centres_m).query(stems.position)[1]  # [B]
    with _timed(spent, "beams"):
        beams = beams_of(stems)
    with _timed(spent, "learned"):
        learned = modal_system(method.generate(voxels, seed=0))
    with _timed(spent, "joints"):
        spectrum = method.generate(voxels, seed=0)
        tree = InteractiveTree(modal_system(spectrum), rig_of(sample.mesh, spectrum), sample.mesh)
        assert tree.joints
    with _timed(spent, "eigenmodes"):
        eigen = elastic_of(grid.coords.astype(np.float64), np.ones(len(grid)))
    stem_radius = stems.radius[cKDTree(stems.position).query(grid.centres_m)[1]]
    by_radii = elastic_of(
        grid.coords.astype(np.float64), np.minimum(3 * np.pi * (stem_radius / grid.voxel_size_m) ** 4, 1.0)
    )
    simulated = modal_system(voxel_spectrum(sample)[1])
    rivals: dict[str, Push] = {
        "learned": lambda at, force: _by_modes(learned, at, force),
        "modes of the simulator": lambda at, force: _by_modes(simulated, at, force),
        "joints": lambda at, force: _by_joints(tree, at, force),
        "eigenmodes": eigen,
        "eigenmodes, by radii": by_radii,
    }
    rows: dict[str, list[tuple[float, float, float]]] = {name: [] for name in ("beams", "voxels", *rivals)}
    count = np.maximum(np.bincount(near, minlength=len(grid)), 1)[:, None]
    ends = _ends(stems, np.random.default_rng(seed))
    for node in ends:
        force = np.cross(
            stems.position[node] - stems.position[stems.parent[node]], np.random.default_rng(node).normal(size=3)
        )
        force /= np.linalg.norm(force)
        true = beams(node, force)  # [B, 3]
        outside = ~on_same_path(stems, int(stems.stem[node]))[stems.stem]
        means = np.stack([np.bincount(near, axis, len(grid)) for axis in true.T], axis=1) / count
        answers = {"beams": true, "voxels": means[near]}
        answers |= {name: push(int(near[node]), force)[near] for name, push in rivals.items()}
        for name, answer in answers.items():
            cosine = (answer * true).sum() / np.sqrt((answer**2).sum() * (true**2).sum())
            energy = (answer**2).sum(axis=1)
            rows[name].append(
                (
                    np.sqrt(max(1 - cosine**2, 0)),
                    energy[outside].sum() / energy.sum(),
                    np.log(abs(answer[node] @ force)),
                )
            )
    table = {name: np.array(of_places) for name, of_places in rows.items()}
    trunk = stems.level[ends] == 0
    return {
        "error": {name: round(float(np.median(of[:, 0])), 3) for name, of in table.items() if name != "beams"},
        "error_of_trunks": {name: round(float(np.median(of[trunk, 0])), 3) for name, of in table.items()},
        "outside": {name: round(float(np.median(of[:, 1])), 4) for name, of in table.items()},
        "softness_correlation": {
            name: round(float(np.corrcoef(of[:, 2], table["beams"][:, 2])[0, 1]), 2)
            for name, of in table.items()
            if name not in ("beams", "voxels", "joints")  # joints are pulled by a displacement
        },
        "seconds": {name: round(value, 2) for name, value in spent.items()},
        "sizes": {"voxels": len(grid), "nodes": len(stems.parent)},
    }


@contextmanager
def _timed(spent: dict[str, float], name: str) -> Iterator[None]:
    begun = time.process_time()
    yield
    spent[name] = time.process_time() - begun


def _ends(stems: Skeleton, rng: np.random.Generator) -> np.ndarray:
    """Draw the outermost nodes of stems, up to an equal number per level."""
    last = np.flatnonzero(np.append(stems.stem[1:] != stems.stem[:-1], True) & (stems.parent >= 0))
    levels = np.unique(stems.level[last])
    own = [last[stems.level[last] == level] for level in levels]
    return np.concatenate([rng.permutation(rows)[: -(-PLACES // len(levels))] for rows in own])


def _by_modes(system: ModalSystem, at: int, force: np.ndarray) -> np.ndarray:
    pushed = modal_force(system, contact_at_voxel(system.grid, at), force)
    return displacement(system.shapes, equilibrium(system, pushed[None]).q)[0].astype(np.float64)


def _by_joints(tree: InteractiveTree, at: int, force: np.ndarray) -> np.ndarray:
    system = tree.system
    x, y, z = (PULL * system.height_m * force).tolist()
    group = ForceGroup(locality=Locality(seed_voxel=at, falloff_m=system.height_m))
    rest = tree.hold(system, group, Drag(at=contact_at_voxel(system.grid, at), displacement_m=(x, y, z)))
    answer = Answer(
        groups=(group,), q=rest.q[None, None], bends=(rest.bend[None],), final=State.at_rest(0, 0), final_bends=()
    )
    return next(tree.voxels(answer)).astype(np.float64)


def beams_of(stems: Skeleton) -> Push:
    """Return a `Push` of all nodes from beams: a 12 × 12 matrix per bone, nodes on the ground clamped."""
    child = np.flatnonzero(stems.parent >= 0)
    parent, x = stems.parent[child], stems.position.astype(np.float64)
    along = x[child] - x[parent]
    length = np.maximum(np.linalg.norm(along, axis=1), 1e-6)
    radius = (stems.radius[child].astype(np.float64) + stems.radius[parent]) / 2
    area, bending = np.pi * radius**2, np.pi * radius**4 / 4
    local = np.zeros((len(child), 12, 12))
    for at, stiffness in ((0, area / length), (3, bending / (1 + POISSON) / length)):  # G J = E I / (1 + ν)
        local[:, [at, at + 6], [at, at + 6]] += stiffness[:, None]
        local[:, [at, at + 6], [at + 6, at]] -= stiffness[:, None]
    one, zero = np.ones_like(length), np.zeros_like(length)
    for across, turn, sign in ((1, 5, one), (2, 4, -one)):
        s, q = sign * 6 * length, length**2
        rows = np.stack(
            [12 * one, s, -12 * one, s, s, 4 * q, -s, 2 * q, -12 * one, -s, 12 * one, -s, s, 2 * q, -s, 4 * q], axis=1
        )
        own = np.array([across, turn, across + 6, turn + 6])
        local[:, own[:, None], own] += (bending / length**3)[:, None, None] * rows.reshape(-1, 4, 4)
    forward = along / length[:, None]
    helper = np.where(
        (np.abs(forward[:, 2]) < 0.9)[:, None], np.stack([zero, zero, one], 1), np.stack([one, zero, zero], 1)
    )
    side = np.cross(helper, forward)
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    axes = np.stack([forward, side, np.cross(forward, side)], axis=1)
    turned = np.zeros((len(child), 12, 12))
    for block in range(0, 12, 3):
        turned[:, block : block + 3, block : block + 3] = axes
    stiffness = turned.transpose(0, 2, 1) @ local @ turned
    free = np.full(len(x), -1)
    free[child] = np.arange(len(child))
    dof = np.concatenate([6 * free[parent][:, None] + np.arange(6), 6 * free[child][:, None] + np.arange(6)], axis=1)
    dof[:, :6][free[parent] < 0] = -1
    row, column = np.broadcast_to(dof[:, :, None], stiffness.shape), np.broadcast_to(dof[:, None], stiffness.shape)
    inside = (row >= 0) & (column >= 0)
    matrix = scipy.sparse.csc_array((stiffness[inside], (row[inside], column[inside])))
    solve = scipy.sparse.linalg.splu(matrix).solve

    def push(node: int, force: np.ndarray) -> np.ndarray:
        load = np.zeros(matrix.shape[0])
        load[6 * free[node] : 6 * free[node] + 3] = force
        moved = np.zeros_like(x)
        moved[child] = solve(load).reshape(-1, 6)[:, :3]
        return moved

    return push


def elastic_of(places: np.ndarray, young: np.ndarray) -> Push:
    """Return a `Push` by linear elasticity of points with a few affine handles; their weights are eigenvectors."""
    nodes = _spread_out(places, KERNELS)
    tree = cKDTree(nodes)
    radius = np.maximum(tree.query(nodes, k=3)[0][:, -1], 3.0)
    kernels = _kernels(places, nodes, radius)
    step = 1e-3
    slopes = [
        (_kernels(places + step * axis, nodes, radius) - _kernels(places - step * axis, nodes, radius)) / (2 * step)
        for axis in np.eye(3)
    ]
    stiffness = sum(slope.T @ scipy.sparse.diags_array(young) @ slope for slope in slopes)
    mass = (kernels.T @ kernels).tocsc()
    tiny = 1e-9 * scipy.sparse.eye_array(len(nodes))
    vectors = scipy.sparse.linalg.eigsh(
        stiffness.tocsc() + tiny * stiffness.diagonal().mean(),
        k=HANDLES,
        M=mass + tiny,
        sigma=0.0,
        v0=np.ones(len(nodes)),
    )[1]
    weights, gradients = kernels @ vectors, [slope @ vectors for slope in slopes]  # [V, H]
    some = np.random.default_rng(0).permutation(len(places))[:POINTS]
    scale = np.ptp(places[:, 2])
    affine = np.concatenate([(places - places.mean(axis=0)) / scale, np.ones((len(places), 1))], axis=1)  # [V, 4]
    basis = (weights[:, :, None] * affine[:, None]).reshape(len(places), -1)  # basis of each coordinate [V, 4 H]
    size = basis.shape[1]
    steps = []
    for axis in range(3):
        part = gradients[axis][some, :, None] * affine[some][:, None]
        part[:, :, axis] += weights[some] / scale
        steps.append(part.reshape(len(some), -1))
    own = young[some, None]
    energy = np.zeros((3, size, 3, size))
    lame, shear = POISSON / ((1 + POISSON) * (1 - 2 * POISSON)), 0.5 / (1 + POISSON)
    for i in range(3):
        for j in range(3):
            product = steps[i].T @ (own * steps[j])
            energy[i, :, j] += lame * product + shear * product.T
            energy[j, :, j] += shear * (steps[i].T @ (own * steps[i]))
    ground = basis[places[:, 2] <= places[:, 2].min() + GROUND * scale]
    clamp = 1e3 * np.trace(energy.reshape(3 * size, -1)) / size / max((ground**2).sum() / size, 1e-30)
    for i in range(3):
        energy[i, :, i] += clamp * (ground.T @ ground)
    full = energy.reshape(3 * size, 3 * size)
    inverse = np.linalg.pinv(full, rcond=1e-13, hermitian=True)

    def push(at: int, force: np.ndarray) -> np.ndarray:
        handles = inverse @ (force[:, None] * basis[at]).ravel()
        return basis @ handles.reshape(3, size).T

    return push


def _spread_out(places: np.ndarray, count: int) -> np.ndarray:
    """Select points by farthest-point sampling."""
    chosen, away = [int(places[:, 2].argmin())], np.full(len(places), np.inf)
    while len(chosen) < min(count, len(places)):
        away = np.minimum(away, ((places - places[chosen[-1]]) ** 2).sum(axis=1))
        chosen.append(int(away.argmax()))
    return places[chosen]


def _kernels(places: np.ndarray, nodes: np.ndarray, radius: np.ndarray) -> scipy.sparse.csr_array:
    """Return Gaussian kernels about the nodes, corrected to sum to 1 and to reproduce linear functions [V, N]."""
    pairs = cKDTree(places).query_ball_point(nodes, REACH * radius)
    node = np.repeat(np.arange(len(nodes)), [len(rows) for rows in pairs])
    place = np.concatenate([np.asarray(rows, np.int64) for rows in pairs])
    arm = nodes[node] - places[place]
    value = np.exp(-(arm**2).sum(axis=1) / radius[node] ** 2)
    terms = np.concatenate([np.ones((len(arm), 1)), arm], axis=1)  # [P, 4]
    products = (value[:, None, None] * terms[:, :, None] * terms[:, None]).reshape(len(value), 16)
    member = scipy.sparse.csr_array(
        (np.ones(len(place)), (place, np.arange(len(place)))), shape=(len(places), len(place))
    )
    moments = (member @ products).reshape(-1, 4, 4)
    moments[:, [1, 2, 3], [1, 2, 3]] += 1e-3 * moments[:, :1, 0] * radius.min() ** 2  # collinear nodes
    correction = np.linalg.solve(moments, np.broadcast_to(np.eye(4)[:, :1], (len(places), 4, 1)))[:, :, 0]
    return scipy.sparse.csr_array(
        (value * (terms * correction[place]).sum(axis=1), (place, node)), shape=(len(places), len(nodes))
    )
