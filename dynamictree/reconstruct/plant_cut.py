"""Segment the plant's Gaussians by a minimum cut: GrabCut (Rother et al. 2004) on Gaussians.

The graph connects each Gaussian with its nearest neighbours; edges are stronger between near Gaussians of similar
colour. Strokes fix the label of the Gaussians seen under them; the others are labelled by colour, the proposal and the
smallest sum of severed edges.
"""

from collections.abc import Callable, Sequence

import numpy as np
from jaxtyping import Bool, Float32, Float64, Int8, Int64
from scipy.ndimage import gaussian_filter
from scipy.sparse import coo_array
from scipy.sparse.csgraph import breadth_first_order, dijkstra, maximum_flow
from scipy.spatial import cKDTree
from skimage.color import rgb2lab

from dynamictree.gaussian.cloud import GaussianCloud
from dynamictree.gaussian.harmonics import SH_0
from dynamictree.gaussian.rasterize import render_on_cpu
from dynamictree.photo_requests import Scribble
from dynamictree.reconstruct.photo_cameras import PhotoCamera, evenly_chosen
from dynamictree.reconstruct.plant_proposal import Proposal, propose_plant
from dynamictree.reconstruct.scribbles import labels_of_strokes

_NEIGHBOURS = 10


def plant_of(
    cloud: GaussianCloud,
    views: list[PhotoCamera],
    scribbles: Sequence[Scribble] = (),
    *,
    masked: bool = False,
    on_progress: Callable[[float], None] = lambda share: None,
) -> Bool[np.ndarray, " G"]:
    """Return a mask of the plant's Gaussians, found by strokes, the cameras' focus and the ground.

    With `masked`, photos had masks, so all Gaussians are the plant except where strokes exclude them.
    `on_progress` gets the completed share, between strokes and between rounds of the cut; its exceptions propagate.

    Raises:
        InputError: a stroke names no photo with a camera, or no Gaussian lies under the strokes of the plant.
    """
    on_progress(0.0)
    every = np.ones(cloud.num_gaussians, np.bool_)
    if masked and not scribbles:
        return every
    proposal = Proposal(near=every, background=~every, central=every) if masked else propose_plant(cloud, views)
    strokes = labels_of_strokes(
        cloud,
        views,
        scribbles,
        background=proposal.background,
        on_stroke=lambda done: on_progress(0.2 + 0.2 * done / len(scribbles)),
    )
    rows = np.flatnonzero(proposal.near | (strokes != 0))
    some = Proposal(near=proposal.near[rows], background=proposal.background[rows], central=proposal.central[rows])
    own = np.zeros(cloud.num_gaussians, np.bool_)
    own[rows] = _cut(cloud.subset(rows), some, strokes[rows], lambda share: on_progress(0.4 + 0.6 * share))
    return own


def _cut(
    cloud: GaussianCloud, proposal: Proposal, strokes: Int8[np.ndarray, " G"], on_progress: Callable[[float], None]
) -> Bool[np.ndarray, " G"]:
    certain = 1000.0
    rejected = 4.0  # log odds against Gaussians that the proposal takes for background
    proposed = 1.5  # log odds of Gaussians that the proposal takes for the plant
    rounds = 4  # iterations of colour model and cut
    color = lab_of(cloud)
    edges, weights = _edges(cloud, color)
    prior = np.where(proposal.central, proposed, 0.0) - np.where(proposal.background, rejected, 0.0)
    drawn = _stroke_odds(cloud, color, edges, strokes)
    if not (strokes[proposal.background] > 0).any():  # no stroke marks background as plant, so neither does nearness
        drawn = np.where(proposal.background, np.minimum(drawn, 0), drawn)
    prior += drawn
    own = proposal.central & (strokes >= 0) | (strokes > 0)
    for done in range(rounds):
        on_progress(done / rounds)
        odds = prior + _color_odds(color, cloud.opacity, own)
        odds = np.where(strokes == 0, odds, certain * strokes)
        previous, own = own, minimum_cut(odds, edges, weights)
        if (previous == own).all():
            break
    return own


def lab_of(cloud: GaussianCloud) -> Float32[np.ndarray, "G 3"]:
    """Return each Gaussian's mean colour over all directions, in CIELAB."""
    return np.asarray(rgb2lab(np.clip(cloud.sh[:, 0] * SH_0 + 0.5, 0, 1)), np.float32)


def _edges(
    cloud: GaussianCloud, color: Float32[np.ndarray, "G 3"]
) -> tuple[Int64[np.ndarray, "E 2"], Float64[np.ndarray, " E"]]:
    """Return the pairs of neighbours, each once, and the cost of separating them [log odds]."""
    color_spread = 12.0  # CIELAB distance that weakens an edge to 61 %; about 2 is just visible
    smoothness = 1.5  # cost of an edge between neighbours of one colour [log odds]
    number = cloud.num_gaussians
    query = cKDTree(cloud.means).query(cloud.means, k=min(_NEIGHBOURS + 1, number))
    distance, near = np.asarray(query[0]), np.asarray(query[1])
    first = np.repeat(np.arange(number), near.shape[1] - 1)
    pairs = np.sort(np.stack([first, near[:, 1:].ravel()], axis=1), axis=1)
    rows = np.unique(pairs[:, 0] * number + pairs[:, 1], return_index=True)[1]  # axis=0 is 10 times slower
    pairs = pairs[rows]
    apart = distance[:, 1:].ravel()[rows]
    alike = np.exp(-(((color[pairs[:, 0]] - color[pairs[:, 1]]) ** 2).sum(axis=1)) / (2 * color_spread**2))
    spacing = np.median(distance[:, 1:])
    return pairs, smoothness * alike / (1 + (apart / (2 * spacing)) ** 2)


def _stroke_odds(
    cloud: GaussianCloud,
    color: Float32[np.ndarray, "G 3"],
    edges: Int64[np.ndarray, "E 2"],
    strokes: Int8[np.ndarray, " G"],
) -> Float64[np.ndarray, " G"]:
    """Compute log odds from strokes; they decay with the path length along neighbours, longer across colours."""
    color_step = 8.0  # CIELAB distance that doubles the length of a step
    stroke_reach = 20.0  # steps between neighbours of one colour over which the odds decay by e
    stroke_odds = 6.0  # log odds beside a stroke
    number = cloud.num_gaussians
    first, second = edges.T
    length = np.linalg.norm(cloud.means[first] - cloud.means[second], axis=1)
    change = np.linalg.norm(color[first] - color[second], axis=1) / color_step
    steps = coo_array((length / np.median(length) * (1 + change**2) + 1e-9, (first, second)), shape=(number, number))
    odds = np.zeros(number)
    for sign in (1, -1):
        if (strokes == sign).any():
            seeds = np.flatnonzero(strokes == sign)
            far = dijkstra(steps.tocsr(), directed=False, indices=seeds, min_only=True, limit=6 * stroke_reach)
            odds += sign * stroke_odds * np.exp(-far / stroke_reach)
    return odds


def _color_odds(
    color: Float32[np.ndarray, "G 3"], weight: Float32[np.ndarray, " G"], own: Bool[np.ndarray, " G"]
) -> Float64[np.ndarray, " G"]:
    """Compute each colour's log odds in the plant against the background, from smoothed histograms."""
    bins = (12, 18, 18)  # number for L*, and for a* and b* from -90 to 90
    most_color = 2.0  # limit of the log odds
    low, high = np.array([0.0, -90.0, -90.0]), np.array([100.0, 90.0, 90.0])
    share = np.clip((color - low) / (high - low), 0, 1 - 1e-6)
    cell = tuple((share * bins).astype(np.int64).T)
    densities = []
    for rows in (own, ~own):
        histogram = np.histogramdd(share[rows], bins, [(0, 1)] * 3, weights=weight[rows])[0]
        smooth = gaussian_filter(histogram, 0.7)
        densities.append(smooth / max(smooth.sum(), 1e-12) + 1e-5)
    odds: Float64[np.ndarray, " G"] = np.clip(np.log(densities[0] / densities[1]), -most_color, most_color)[cell]
    return odds


def minimum_cut(
    odds: Float64[np.ndarray, " G"], edges: Int64[np.ndarray, "E 2"], weights: Float64[np.ndarray, " E"]
) -> Bool[np.ndarray, " G"]:
    """Return the labels with the smallest sum of severed edges and log odds against them; undecided nodes are false."""
    unit = 1000  # scale of capacities, since the flow is in integers
    number = len(odds)
    source, sink = number, number + 1
    every = np.arange(number)
    price = np.rint(unit * weights).astype(np.int32)
    gain = np.rint(unit * odds).astype(np.int32)
    rows = np.concatenate([edges[:, 0], edges[:, 1], np.full(number, source), every])
    columns = np.concatenate([edges[:, 1], edges[:, 0], every, np.full(number, sink)])
    capacity = np.concatenate([price, price, np.maximum(gain, 0), np.maximum(-gain, 0)])
    graph = coo_array((capacity, (rows, columns)), shape=(number + 2, number + 2)).tocsr()
    graph.eliminate_zeros()
    residual = (graph - maximum_flow(graph, source, sink, method="dinic").flow).tocsr()
    residual.data[residual.data < 0] = 0
    residual.eliminate_zeros()
    chosen = np.zeros(number + 2, np.bool_)
    chosen[breadth_first_order(residual, source, return_predecessors=False)] = True
    return chosen[:number]


def faint_floaters(cloud: GaussianCloud, own: Bool[np.ndarray, " G"]) -> Bool[np.ndarray, " G"]:
    """Return a mask of floaters around the plant: faint Gaussians far from all opaque ones, and stray opaque ones.

    They compensate errors of a textured background. If few are opaque, none is a floater; wide ones lie farther apart.
    """
    together, stray = 8, 3.0  # rank of the neighbour that gives the spacing; multiple of the median spacing of strays
    reach = 2.5  # standard deviations along the middle axis of a Gaussian to which its surface goes on
    rows = np.flatnonzero(own)
    floaters = np.zeros(cloud.num_gaussians, np.bool_)
    opaque = rows[cloud.opacity[rows] > 0.5]
    if len(opaque) < max(together, 0.2 * len(rows)):
        return floaters
    spacing = np.asarray(cKDTree(cloud.means[opaque]).query(cloud.means[opaque], k=together)[0])[:, -1]
    usual, wide = float(np.median(spacing)), reach * np.median(cloud.scales, axis=1)
    largest = np.maximum(wide, stray * usual)
    body = opaque[spacing <= largest[opaque]]
    farthest = np.where(cloud.opacity > 0.5, largest, np.clip(wide, 0.5 * usual, stray * usual))
    floaters[rows] = cKDTree(cloud.means[body]).query(cloud.means[rows])[0] > farthest[rows]
    return floaters


def background_coloured(
    cloud: GaussianCloud, own: Bool[np.ndarray, " G"], views: Sequence[PhotoCamera]
) -> Bool[np.ndarray, " G"]:
    """Return a mask of chosen Gaussians that have the colour of what is behind them in every view.

    Of a plant before black cloth they are its black rim: they change no picture, so learning does not remove them.
    """
    most_views, side_px = 12, 320
    visible = 20.0  # CIELAB difference; the rim of black cloth has less, leaves before a lawn have more
    rows = np.flatnonzero(own)
    color, rest = lab_of(cloud), cloud.subset(~own)
    largest = np.full(cloud.num_gaussians, -1.0)  # difference; negative if not chosen or outside of all views
    for view in (view.reduced(side_px) for view in evenly_chosen(views, most_views)):
        behind = render_on_cpu(rest, view.camera, width=view.width, height=view.height)
        x, y, depth = view.camera.project(cloud.means[rows].astype(np.float64), view.width, view.height).T
        seen = (depth > 0) & (x >= 0) & (x < view.width) & (y >= 0) & (y < view.height)
        at, inside = (y[seen].astype(int), x[seen].astype(int)), rows[seen]
        difference = np.linalg.norm(rgb2lab(behind.over((0.0, 0.0, 0.0)))[at] - color[inside], axis=1)
        largest[inside] = np.maximum(largest[inside], difference)
    hidden: Bool[np.ndarray, " G"] = (largest >= 0) & (largest <= visible)
    return hidden
