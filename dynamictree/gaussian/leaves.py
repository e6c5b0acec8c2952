"""Leaves of a captured cloud: green parts of a crown that is one surface, on a narrow foot about which they flutter.

Only their Gaussians flutter: the surface would stretch. A leaf begins as what a narrow bone carries. Its blade is a
closed surface with bones on both sides, so bones along it are added; what lies along a stem is no leaf.
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Float64, Int64
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from dynamictree.gaussian.binding import STILL, Binding, Leaves
from dynamictree.gaussian.harmonics import SH_0
from dynamictree.mesh import part_bounds
from dynamictree.rig.flutter import Flutter, sample_flutter
from dynamictree.rig.pose import GROUND
from dynamictree.rig.rig import Rig
from dynamictree.spectrum import SparseVoxelSpectrum


def flutter_leaves(
    binding: Binding, rig: Rig, spectrum: SparseVoxelSpectrum, size: float
) -> tuple[Binding, Flutter | None]:
    """Find the leaves of a bound cloud, if it has any, and sample their flutter.

    Where the mesh has leaf cards, the cards flutter instead. `size` is a factor: 0 for none, 1 as in nature.
    """
    # excess green (2 g - r - b) / (r + g + b), which separates plants from soil (Woebbecke et al. 1995, doi:
    # 10.13031/2013.27838): 89 % of a houseplant have more, nothing of bare wood
    least_green = 0.05
    least_spread = 0.02  # spread of the excess; a scan without colours, which is shaded in one, has 0.007
    cloud, skeleton, places = binding.cloud, rig.skeleton, binding.vertices.astype(np.float64)
    foot = _leaves(rig, places)  # bone at the foot of each vertex's leaf, or the ground
    of = np.where(binding.moving, foot[binding.triangles[binding.face_of, 0]], 0)
    red, green, blue = np.clip(0.5 + SH_0 * cloud.sh[:, 0], 1e-3, 1).T
    excess = (2 * green - red - blue) / (red + green + blue)
    is_leaf = np.bincount(of, cloud.opacity * (excess - least_green), len(skeleton)) > 0
    is_leaf[0] = False
    leaf = np.flatnonzero(is_leaf)
    if len(leaf) == 0 or np.ptp(np.quantile(excess[binding.moving], (0.1, 0.9))) < least_spread:
        return binding, None
    carriers = np.unique(binding.triangles)
    order = carriers[np.argsort(np.linalg.norm(places - skeleton.foot_m[foot], axis=1)[carriers], kind="stable")]
    vertex = [order[np.argmax(foot[order] == one)] for one in leaf]  # nearest to the foot
    reach = np.array([places[foot == one].mean(axis=0) for one in leaf]) - skeleton.foot_m[leaf]
    reach_m = np.maximum(np.linalg.norm(reach, axis=1), 1e-9)
    leaf_of = np.where(is_leaf[of], np.searchsorted(leaf, of), STILL).astype(np.int32)
    direction = (reach / reach_m[:, None]).astype(np.float32)
    flutter = sample_flutter(direction, 2 * reach_m, skeleton.above[leaf], np.full(len(leaf), size), spectrum)
    return replace(binding, leaves=Leaves(of=leaf_of, vertex=np.array(vertex, np.int32))), flutter


def _leaves(rig: Rig, places: Float64[np.ndarray, "N 3"]) -> Int64[np.ndarray, " N"]:
    """Return the bone at the foot of each vertex's leaf, or the ground."""
    most_vertices = 12_000  # vertices that decide which bones lie along which: all of a cloud's own mesh, 0.1 s
    # extent of a leaf, and distance between its sides, relative to the tree's extent: at 0.012 blades stay in pieces
    longest, thickest = 0.2, 0.018
    foot, tree_m = _feet(rig, places, longest)  # row per bone
    count = len(foot)
    begins = np.bincount(foot, minlength=count) > 0
    begins[0] = False
    some = slice(None, None, -(-len(places) // most_vertices))
    bone = rig.vertices.rows[some, 0]
    piece = np.where(foot > 0, foot, np.arange(count))[bone]  # a leaf, or a bone of no leaf
    pairs = cKDTree(places[some]).query_pairs(thickest * tree_m, output_type="ndarray")
    one, other = np.concatenate([pairs, pairs[:, ::-1]]).T
    near = np.unique(np.stack([one, piece[other]])[:, piece[one] != piece[other]], axis=1)  # vertex, another piece
    touching = csr_array((np.ones(near.shape[1]), (piece[near[0]], near[1])), shape=(count, count)).tocoo()
    along = begins[touching.col] & (touching.data > 0.5 * np.bincount(piece, minlength=count)[touching.row])
    edges = csr_array((along[along].astype(np.int8), (touching.row[along], touching.col[along])), shape=(count, count))
    merged = connected_components(edges, directed=False)[1][np.where(foot > 0, foot, np.arange(count))]  # row per bone
    first = np.zeros(count, np.int64)
    first[merged[begins][::-1]] = np.flatnonzero(begins)[::-1]  # nearest to the ground
    low, high = part_bounds(merged[bone], places[some])
    long = np.flatnonzero(np.linalg.norm(high - low, axis=1) > longest * tree_m)
    leaf = np.where(np.isin(merged, long), foot, first[merged])  # row per bone
    leaf[0] = 0
    by_stem = np.bincount(leaf[bone], np.bincount(one, leaf[bone[other]] == 0, len(bone)) > 0, count)  # vertices
    leaf[by_stem[leaf] > 2 / 3 * np.bincount(leaf[bone], minlength=count)[leaf]] = 0
    return np.asarray(leaf[rig.vertices.rows[:, 0]])


def _feet(rig: Rig, places: Float64[np.ndarray, "N 3"], longest: float) -> tuple[Int64[np.ndarray, " B"], float]:
    """Return the narrow bone, carrying no other, above each bone (or the ground), and the largest tree's extent [m]."""
    narrow_share = 1 / 3  # width of a leaf's foot relative to its blade; ends of bones would fray, a blade has several
    skeleton, bone = rig.skeleton, rig.vertices.rows[:, 0]
    low, high = part_bounds(bone, places)
    missing = ((0, len(skeleton) - len(low)), (0, 0))  # the last bones carry no vertex
    low, high = np.pad(low, missing, constant_values=np.inf), np.pad(high, missing, constant_values=-np.inf)
    width_m = np.linalg.norm(np.maximum(high - low, 0), axis=1)
    widest_m = width_m.copy()
    for level in reversed(skeleton.levels):
        above = skeleton.above[level]
        np.minimum.at(low, above, low[level])
        np.maximum.at(high, above, high[level])
        np.maximum.at(widest_m, above, widest_m[level])
    extent_m = np.linalg.norm(np.maximum(high - low, 0), axis=1)
    tree_m = float(extent_m[1:][skeleton.above[1:] == GROUND].max(initial=0))
    narrow = skeleton.in_surface & (width_m <= narrow_share * widest_m) & (extent_m <= longest * tree_m)
    carries = np.zeros(len(skeleton), np.bool_)  # a narrow bone
    for level in reversed(skeleton.levels):
        np.logical_or.at(carries, skeleton.above[level], narrow[level] | carries[level])
    foot = np.where(narrow & ~carries, np.arange(len(skeleton)), 0)
    for level in skeleton.levels:
        foot[level] = np.where(foot[level] > 0, foot[level], foot[skeleton.above[level]])
    return foot, tree_m
