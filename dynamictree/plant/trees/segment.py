"""Segment individual trees in points: stems by slices, crowns by comparative shortest paths from the stems.

A connected part that stands on the ground is one tree, or as many as it has stems. A cell belongs to the stem with the
shortest path to it, relative to the stem's radius to the power 2/3, since thick stems have wide crowns (Tao et al.,
Segmenting tree crowns from terrestrial and mobile LiDAR data by exploring ecological theories, 2015). Unconnected
cells belong to the nearest tree.
"""

import numpy as np
import scipy  # submodules load lazily, so the service starts without them
from jaxtyping import Float64, Int32, Int64

from dynamictree.errors import InputError
from dynamictree.mesh import SourceWarning
from dynamictree.plant.trees.cells import OccupiedCells, cell_graph, occupied_cells
from dynamictree.plant.trees.stems import Stem, find_stems, join_stems

_OWN_TOP = 0.02
"""Least rise of a tree above the highest contact of its crown with a neighbour's [share of its height].

Tips of hanging branches (of seven trees that were cut into pieces) have 0 to 0.01, seldom 0.03, since the branch
continues upward in its tree; trees in stands 0.06 and more, with interlocking crowns 0.02 (docs/decisions/plant.md)."""


def segment_trees(points: Float64[np.ndarray, "P 3"], *, is_scan: bool = False) -> Int32[np.ndarray, " P"]:
    """Return the tree of each point [m, +Z up]; -1 for ground. Trees of a scan may end below another's crown.

    Trees are numbered from 0, by x, then y.

    Raises:
        InputError: the points are a scan, extend far wider than they are tall, and have no stems to separate them.
    """
    one_tree = np.zeros(len(points), np.int32)
    if np.ptp(points[:, 2]) <= 0:
        return one_tree
    cells = occupied_cells(points, is_scan=is_scan)
    plant = np.flatnonzero(~cells.ground)
    if len(plant) == 0:
        return one_tree
    graph = cell_graph(cells.coords[plant])
    seeds = _seeds(cells, plant, graph)
    if len(seeds) <= 1:
        if is_scan:
            _refuse_canopy(cells, plant)
        return one_tree
    grown = _grow(cells, plant, graph, seeds)
    if not is_scan:
        own = _without_tips(cells.coords[plant, 2], graph, grown, seeds)
        if len(own) == 1:
            return one_tree
        if len(own) < len(seeds):
            seeds, grown = own, _grow(cells, plant, graph, own)
    label = np.full(len(cells.coords), -1, np.int64)
    label[plant] = grown
    label = _with_feet(cells, label, seeds)
    return _in_order(cells, label)


def _seeds(cells: OccupiedCells, plant: Int64[np.ndarray, " M"], graph: "scipy.sparse.csr_array") -> list[Stem]:
    """Find the seeds of trees: stems, or the lowest cells of connected parts without stems."""
    shortest = 0.3  # share of the tallest tree's height; lower parts are undergrowth
    stands_share = 0.1  # share of the height, within which a tree starts above the ground
    fewest = 0.03  # share of the largest part's cells; smaller parts are debris
    above = cells.above[plant]
    part = scipy.sparse.csgraph.connected_components(graph, directed=False)[1]
    count = np.bincount(part)
    top, bottom = np.zeros(len(count)), np.full(len(count), np.inf)
    np.maximum.at(top, part, above)
    np.minimum.at(bottom, part, above)
    tall = float(top.max()) + 1
    stands = (bottom <= stands_share * tall) & (top - bottom >= shortest * tall) & (count >= fewest * count.max())
    stems: list[Stem] = []
    for one in np.flatnonzero(stands):
        rows = plant[part == one]
        own = find_stems(cells.coords, cells.above, rows)
        if not own:
            height = cells.coords[rows, 2]  # not above the ground, which is unknown below a drooping leaf
            foot = rows[height <= height.min() + 0.05 * tall]
            middle, higher = (np.median(cells.coords[some, :2], axis=0) for some in (foot, rows))
            own = [Stem(cells=foot, middle=middle, higher=higher, radius=1.0)]
        stems += own
    standing = [stem for stem in stems if not cells.afloat[stem.cells].mean() > 0.5]
    return join_stems(standing or stems, tall)


def _without_tips(
    height: Int64[np.ndarray, " M"], graph: "scipy.sparse.csr_array", grown: Int64[np.ndarray, " M"], seeds: list[Stem]
) -> list[Stem]:
    """Select the seeds that are no tips of hanging branches: with a top of their own, thicker; else the thickest."""
    thicker = 1.5  # [cells of the thickest tip of those that touch]; thinner seeds are tips as well
    edges = graph.tocoo()
    one, other = grown[edges.row], grown[edges.col]
    low, top, touch = np.full(len(seeds), np.inf), np.full(len(seeds), -np.inf), np.full(len(seeds), -np.inf)
    np.minimum.at(low, grown, height)
    np.maximum.at(top, grown, height)
    between = np.minimum(height[edges.row], height[edges.col])[one != other]
    for side in (one, other):
        np.maximum.at(touch, side[one != other], between)
    rises = top - touch >= _OWN_TOP * (top - low)
    thickness = np.array([len(seed.cells) for seed in seeds])
    touching = scipy.sparse.coo_array((np.ones(len(one)), (one, other)), shape=(len(seeds),) * 2)
    group, own = scipy.sparse.csgraph.connected_components(touching, directed=False)[1], []
    for rows in (np.flatnonzero(group == number) for number in np.unique(group)):
        trees = rows[rises[rows] & (thickness[rows] >= thicker * thickness[rows[~rises[rows]]].max(initial=0))]
        own += [seeds[row] for row in (trees if len(trees) else rows[[thickness[rows].argmax()]])]
    return own


def _grow(
    cells: OccupiedCells, plant: Int64[np.ndarray, " M"], graph: "scipy.sparse.csr_array", seeds: list[Stem]
) -> Int64[np.ndarray, " M"]:
    """Assign each plant cell to the tree with the shortest relative path."""
    radius_power = 2 / 3
    place = np.full(len(cells.coords), -1)
    place[plant] = np.arange(len(plant))
    best, label = np.full(len(plant), np.inf), np.full(len(plant), -1)
    for number, seed in enumerate(seeds):
        way = scipy.sparse.csgraph.dijkstra(graph, directed=False, indices=place[seed.cells], min_only=True)
        way /= seed.radius**radius_power
        closer = way < best
        best[closer], label[closer] = way[closer], number
    loose = np.flatnonzero(label < 0)
    if len(loose):
        reached = np.flatnonzero(label >= 0)
        nearest = np.asarray(scipy.spatial.cKDTree(cells.coords[plant[reached]]).query(cells.coords[plant[loose]])[1])
        label[loose] = label[reached[nearest]]
    return label.astype(np.int64)


def _with_feet(cells: OccupiedCells, label: Int64[np.ndarray, " V"], seeds: list[Stem]) -> Int64[np.ndarray, " V"]:
    """Assign the ground cells under a stem to its tree."""
    foot = 0.03  # share of the height; radius of a stem's foot on the ground
    ground = np.flatnonzero(cells.ground)
    if len(ground):
        middles = np.array([seed.middle for seed in seeds])
        away, nearest = scipy.spatial.cKDTree(middles).query(cells.coords[ground, :2])
        under = away < foot * cells.above.max()
        label[ground[under]] = np.asarray(nearest)[under]
    return label


def _in_order(cells: OccupiedCells, label: Int64[np.ndarray, " V"]) -> Int32[np.ndarray, " P"]:
    """Return the tree of each point, numbered by position."""
    centres = cells.centres_m
    feet = []
    for number in range(int(label.max()) + 1):
        own = centres[label == number]
        low = own[own[:, 2] <= own[:, 2].min() + 0.05 * np.ptp(own[:, 2])]
        feet.append(np.median(low[:, :2], axis=0).tolist())
    order = sorted(range(len(feet)), key=lambda number: feet[number])
    renumber = np.full(len(feet) + 1, -1, np.int32)
    renumber[order] = np.arange(len(feet))
    return np.asarray(renumber[label[cells.cell_of_point]], np.int32)


def _refuse_canopy(cells: OccupiedCells, plant: Int64[np.ndarray, " M"]) -> None:
    widest = 4.0  # [height]; a wider part with one stem is no tree
    extent = np.ptp(cells.coords[plant], axis=0) * cells.size_m
    if extent[:2].min() > widest * extent[2]:
        raise InputError(
            f"the file is {extent[0]:.3g} m by {extent[1]:.3g} m and {extent[2]:.3g} m tall, so it holds more than one "
            "tree, but no stems are seen by which to separate them; cut one tree out, or scan from the ground"
        )


def require_tree(number: int, tree_of: Int32[np.ndarray, " E"] | None) -> None:
    """Check a tree's number, counted from 1; `tree_of` counts from 0, and is None for one tree.

    Raises:
        InputError: there is no such tree.
    """
    count = 1 if tree_of is None else int(tree_of.max()) + 1
    if not 1 <= number <= count:
        trees = "1 tree" if count == 1 else f"{count} trees, numbered from 1"
        raise InputError(f"tree is {number}, and the file holds {trees}")


def several_trees(count: int) -> SourceWarning:
    """Create the warning that a file has several trees."""
    message = (
        f"{count} trees stand in the file; each moves by itself; tree=1 to tree={count} takes one of them, and "
        "`trees` lists where they stand"
    )
    return SourceWarning(code="several-trees", message=message)
