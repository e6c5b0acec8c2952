"""Reach of a poke, and stretch under a large push, on generated trees.

Measured: the share of kinetic energy outside of the poked stem, its descendants and ancestors, with and without
locality; the 99th percentile of edge stretch if the top is pushed aside by 20 % of the height; and the motion of parts
that neither carry the grip nor hang on it, for pulls of branches ten times as long.
"""

import numpy as np
import scipy.sparse

from benchmarks._interaction import bent_by
from benchmarks._machine import machine
from dynamictree.mesh import edges_of
from dynamictree.modal.force import Drag, Impulse, compliance, contact_at_voxel, equilibrium, generalised_force
from dynamictree.modal.interactive_tree import ForceGroup, InteractiveTree, Locality
from dynamictree.modal.pull import grip_at, pull_to
from dynamictree.modal.step import State, exact_step
from dynamictree.modal.step import run as run_modes
from dynamictree.modal.system import ModalSystem, default_falloff_m, displacement, modal_system
from dynamictree.rig.pose import carried, poses
from dynamictree.rig.rig import rig_of
from dynamictree.voxel.voxelize import surface_average
from lab.dataset.sample import Sample, make_sample, voxel_spectrum
from lab.dataset.sapling import LEAF
from lab.dataset.stem_skeleton import Skeleton

TARGET = 0.05
TREES = ((3, "round-broadleaf"), (4, "maple"), (5, "conical-conifer"), (6, "weeping"), (9, "columnar"))
POKES_PER_LEVEL = 4
TOP_SHARE = 0.2  # [share of the height]
PULLS = 40  # pulls per tree, each by these shares of the height
PULL_SHARES = (0.01, 0.02, 0.05)
BRANCH_SHARE = 0.05  # largest share of the voxels that a branch's joint carries
BRANCH_LENGTHS = 10  # length of a branch [pulls]


def run() -> dict[str, object]:
    rows, pulled = {}, {}
    for seed, species in TREES:
        sample = make_sample(seed, species)
        _, spectrum = voxel_spectrum(sample)
        system = modal_system(spectrum)
        rows[species] = _pokes(sample, system) | _push(sample, system)
        pulled[species] = _pulls(sample, system)
    local = [share for row in rows.values() for share in row["local"]]
    everywhere = [share for row in rows.values() for share in row["all_modes"]]
    return {
        "value": round(float(np.mean(local)), 4),
        "unit": "share of kinetic energy outside of the poked branch and its ancestors",
        "target": TARGET,
        "median": round(float(np.median(local)), 4),
        "worst": max(local),
        "within_target": round(float(np.mean(np.array(local) <= TARGET)), 3),
        "all_modes": round(float(np.mean(everywhere)), 4),
        "mean_weight_on_the_poked_stem": round(
            float(np.mean([weight for row in rows.values() for weight in row["own_weight"]])), 3
        ),
        "edge_stretch_p99_at_20_percent": [row["stretch"] for row in rows.values()],
        "pulled": _motion_elsewhere([pull for pulls in pulled.values() for pull in pulls]),
        "pulled_by_tree": {species: _motion_elsewhere(pulls) for species, pulls in pulled.items()},
        "trees": rows,
        **machine("numpy", "scipy", "numba"),
    }


def _pokes(sample: Sample, system: ModalSystem) -> dict[str, list[float]]:
    stems, tree, rng = sample.skeleton, _tree(sample, system), np.random.default_rng(0)
    owner = stem_of_voxels(sample, system)
    wood = surface_average(sample.mesh, system.grid) @ (sample.part != LEAF).astype(np.float64) > 0.5  # [V]
    shares: dict[str, list[float]] = {"all_modes": [], "local": [], "own_weight": []}
    for level in (1, 2):
        candidates = np.intersect1d(stems.stem[stems.level == level], owner[wood])
        for poked in rng.choice(candidates, POKES_PER_LEVEL, replace=False):
            base = stems.position[np.flatnonzero(stems.stem == poked)[0]]
            inside = on_same_path(stems, int(poked))[owner]
            for own in (np.flatnonzero(owner == poked), np.flatnonzero((owner == poked) & wood)):
                # the outermost voxel of all, mostly a leaf, and that of the wood
                row = int(own[np.argmax(((system.grid.centres_m[own] - base) ** 2).sum(axis=1))])
                place = Locality(seed_voxel=row, falloff_m=default_falloff_m(system))
                energy, weights = _kinetic(system, row), tree.weights([ForceGroup(locality=place)])[0]
                weighed = energy * weights**2
                shares["all_modes"].append(round(float(energy[~inside].sum() / energy.sum()), 4))
                shares["local"].append(round(float(weighed[~inside].sum() / weighed.sum()), 4))
                shares["own_weight"].append(round(float(weights[owner == poked].mean()), 4))
    return shares


def _pulls(sample: Sample, system: ModalSystem) -> list[np.ndarray]:
    """Return the motion of parts that neither carry nor hang on the grip of a long branch's pull [pulls]."""
    tree, rng, height = _tree(sample, system), np.random.default_rng(0), sample.mesh.height_m
    joints, rest = tree.joints, system.grid.centres_m.astype(np.float64)
    pulls = []
    for row in rng.choice(np.flatnonzero(joints.of_voxel > 0), PULLS, replace=False):
        chain, point = joints.chain(int(row)), tree.grip_point(contact_at_voxel(system.grid, int(row)))
        grip, light = grip_at(joints, chain, point), joints.num_carried[chain] < BRANCH_SHARE * len(rest)
        places = np.concatenate([point.point_m[None], joints.place_m[chain]])
        length = np.linalg.norm(np.diff(places, axis=0), axis=1)[light].sum()
        along = point.point_m - joints.place_m[chain[light][-1] if light.any() else chain[-1]]
        hangs = np.arange(len(joints.parent)) == chain[0]
        for joint in range(int(chain[0]) + 1, len(hangs)):
            hangs[joint] |= hangs[joints.parent[joint]]
        hangs[chain] = True
        for share in PULL_SHARES:
            across = np.cross(along, rng.normal(size=3))
            if length < BRANCH_LENGTHS * share * height:
                continue
            pull = share * height * across / np.linalg.norm(across)
            bends = np.zeros((len(joints.parent), 3))
            bends[chain] = pull_to(grip, pull).bend
            still = poses(tree.bones.skeleton, np.zeros((1, len(tree.bones.skeleton), 3), np.float32))
            moved = carried(tree.bones.skeleton, joints.bent(still, bends), 0, system.grid.centres_m, tree.bones.voxels)
            pulls.append(np.linalg.norm(moved[~hangs[joints.of_voxel]], axis=1) / (share * height))
    return pulls


def _motion_elsewhere(pulls: list[np.ndarray]) -> dict[str, float]:
    """Return the 95th percentile over all pulls' voxels, and the share of pulls whose own is within the target."""
    own = np.array([np.percentile(moved, 95) for moved in pulls])
    return {
        "pulls": len(pulls),
        "p95": round(float(np.percentile(np.concatenate(pulls), 95)), 4),
        "within_target": round(float((own <= TARGET).mean()), 3),
    }


def _tree(sample: Sample, system: ModalSystem) -> InteractiveTree:
    _, spectrum = voxel_spectrum(sample)
    return InteractiveTree(system, rig_of(sample.mesh, spectrum), sample.mesh)


def stem_of_voxels(sample: Sample, system: ModalSystem) -> np.ndarray:
    """Return the stem with the largest share of each voxel's surface; a leaf counts to its stem."""
    stems, nodes = sample.skeleton, sample.motion.position
    stem_of_node = np.empty(len(nodes), np.int64)
    stem_of_node[: len(stems.stem)] = stems.stem
    grown = np.flatnonzero(stems.parent >= 0)
    start, along = stems.position[stems.parent[grown]], stems.position[grown] - stems.position[stems.parent[grown]]
    for leaf in range(len(stems.stem), len(nodes)):  # a leaf's base is on its stem's axis
        arm = nodes[leaf] - start
        share = np.clip((arm * along).sum(axis=1) / np.maximum((along**2).sum(axis=1), 1e-12), 0, 1)
        gap = ((arm - share[:, None] * along) ** 2).sum(axis=1)
        stem_of_node[leaf] = stems.stem[grown[np.argmin(gap)]]
    stem = stem_of_node[sample.node]
    member = scipy.sparse.csr_array((np.ones(len(stem)), (np.arange(len(stem)), stem)))
    shares = (surface_average(sample.mesh, system.grid) @ member).tocsr()  # [V, S]
    return np.asarray(shares.argmax(axis=1)).ravel()


def _kinetic(system: ModalSystem, row: int) -> np.ndarray:
    """Return each voxel's kinetic energy over two seconds after a knock, up to a factor."""
    at = contact_at_voxel(system.grid, row)
    softest = np.linalg.eigh(compliance(system, at))[1][:, 2]
    knock = Impulse(at=at, impulse_n_s=tuple((5 * softest).tolist()))
    pushed = generalised_force(system, knock, dt_s=1 / 30, num_frames=60)[:, None] / system.modal_mass
    frames, _ = run_modes(exact_step(system, 1 / 30), State.at_rest(1, system.num_modes), pushed)
    velocity = np.diff(displacement(system.shapes, frames[:, 0]), axis=0)
    return (velocity.astype(np.float64) ** 2).sum(axis=(0, 2))


def _push(sample: Sample, system: ModalSystem) -> dict[str, float]:
    mesh, grid = sample.mesh, system.grid
    top = int(np.argmax(grid.centres_m[:, 2]))
    at = contact_at_voxel(grid, top)
    softest = np.linalg.eigh(compliance(system, at))[1][:, 2]
    q = equilibrium(
        system, generalised_force(system, Drag(at=at, force_n=tuple(softest.tolist())), dt_s=0.1, num_frames=1)
    ).q
    tree, highest = _tree(sample, system), int(np.argmax(mesh.vertices[:, 2]))
    displacement_by = bent_by(tree)
    wanted = TOP_SHARE * mesh.height_m
    strength = wanted / float(np.linalg.norm(displacement(system.shapes, q)[0, top]))
    for _ in range(6):  # the top moves on an arc, so less far: push harder until it is there
        strength *= wanted / float(np.linalg.norm(displacement_by(strength * q)[highest]))
    bent = displacement_by(strength * q)
    start, end = edges_of(mesh.faces).T
    rest = np.linalg.norm(mesh.vertices[start] - mesh.vertices[end], axis=1)
    now = np.linalg.norm((mesh.vertices + bent)[start] - (mesh.vertices + bent)[end], axis=1)
    return {
        "stretch": round(float(np.percentile(np.abs(now / rest - 1)[rest > 1e-4], 99)), 4),
        "top_moved_share": round(float(np.linalg.norm(bent[highest]) / mesh.height_m), 3),
    }


def on_same_path(stems: Skeleton, poked: int) -> np.ndarray:
    """Return whether each stem is the poked one, carried by it, or an ancestor of it."""
    above = np.full(len(stems.stem_length_m), -1)
    crossing = (stems.parent >= 0) & (stems.stem[stems.parent] != stems.stem)
    above[stems.stem[crossing]] = stems.stem[stems.parent[crossing]]

    def line(stem: int) -> set[int]:
        parts = set()
        while stem >= 0:
            parts.add(stem)
            stem = int(above[stem])
        return parts

    up = line(poked)
    return np.array([stem in up or poked in line(stem) for stem in range(len(above))])
