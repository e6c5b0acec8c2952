"""Amplitude of each voxel at each frequency, and its lean: the deterministic part of a motion.

The network predicts, in the wind's frame and over the tree's height, the mean displacement c_0 and the size A of every
other coefficient. The diffusion model learns the rest, u = c / A. Both c_0 and A grow with the drag d = U^1.6 as
tanh(s d) / s, like a stem's lean in the simulator, and A also with the gusts; the network predicts the saturation s of
each size. The vertical part that is sway times lean grows with d². The speed is an input too, since it changes the
shape of a motion: flutter sets in, and the gusts' spectrum moves to higher frequencies.
"""

import math
from dataclasses import replace
from functools import partial

import numpy as np
import torch
from jaxtyping import Float, Float32, Int64
from scipy.sparse import csc_array, csr_array, diags_array
from scipy.sparse.linalg import splu
from torch import Tensor, nn
from torch.nn import functional

from dynamictree.models.small.features import CHAIN, NUM_SCALARS, NUM_VECTORS, NUM_WIND, TreeFeatures, node_features
from dynamictree.models.small.foliage import ARM, NUM_FOLIAGE_VALUES, STEM
from dynamictree.models.small.surface_shape import NUM_SURFACE
from dynamictree.models.threads import run_on_cores
from dynamictree.models.wind import MIN_GUST, REFERENCE_SPEED
from dynamictree.sparse.pool import pool_to

FLOOR = 3e-6
"""Share of the height below which sizes count as no motion, at drag and gust 1: 0.01 mm of 10 m in a usual wind."""
AXES = 3
CONTEXT = (2, 4)  # levels of the pyramid
NUM_OWN_SCALARS = NUM_SCALARS + NUM_SURFACE + NUM_FOLIAGE_VALUES - 3 + 2 * CHAIN * (3 + 1)
NUM_OWN_VECTORS = NUM_VECTORS + 1
NUM_OWN = NUM_OWN_SCALARS + 3 * NUM_OWN_VECTORS
NUM_INPUTS = (len(CONTEXT) + 2) * NUM_OWN + NUM_WIND
CLIP = 5.0  # standard deviations
DROPOUT = 0.1
"""Rate in training. A tree's gusts are random, and features of the whole tree would let the network memorize them."""
BAND = 2048
"""Rows that one thread computes at a time: few enough that their hidden layers stay in a core's cache."""
LEAN = 0.5
START = -7.0
"""Initial lean over the motion's size at gust 1, and initial ln A there: their size in the dataset."""
DRAG_EXPONENT = 1.6
"""Exponent of the speed, as in the simulator: growth of a size in weak wind, where nothing saturates."""
SATURATION = -1.9
"""Initial ln s: that of a stem of mean slenderness in the simulator."""
WOOD_STIFFNESS = 30.0
"""Smoothing of ln A along wood, over about √30 voxels: the network's errors there bend stems that are straight."""
BENT = (1e-6, 50.0)  # bounds of s d, in which tanh(s d) / (s d) is exact in float32


class AmplitudeNetwork(nn.Module):
    """Network per voxel: inputs are its features, their means over its surroundings and over the tree, and the wind.

    It has no convolution: a voxel's motion depends on the chain of stems that bears it, which is in its features. A
    U-Net at 32³ learned less in ten times the time (docs/decisions).
    """

    mean: Tensor  # [F], mean of the inputs
    deviation: Tensor  # [F]

    def __init__(self, *, num_frequencies: int, width: int, depth: int) -> None:
        super().__init__()
        self.num_frequencies = num_frequencies
        self.enter = nn.Linear(NUM_INPUTS, width)
        self.blocks = nn.ModuleList(
            nn.Sequential(
                nn.LayerNorm(width),
                nn.Linear(width, 2 * width),
                nn.Sequential(nn.SiLU(), nn.Dropout(DROPOUT)),
                nn.Linear(2 * width, width),
            )
            for _ in range(depth)
        )
        self.head = nn.Sequential(nn.LayerNorm(width), nn.SiLU())
        self.sizes = nn.Linear(width, AXES * num_frequencies)
        self.saturation = nn.Linear(width, AXES * (num_frequencies - 1))
        self.second_order = nn.Linear(width, 2)
        for layer, start in ((self.saturation, SATURATION), (self.second_order, 0.0)):
            nn.init.zeros_(layer.weight)
            nn.init.constant_(layer.bias, start)
        self.register_buffer("mean", torch.zeros(NUM_INPUTS))
        self.register_buffer("deviation", torch.ones(NUM_INPUTS))

    def forward(
        self, inputs: Float32[Tensor, "R I"], wind: Float32[Tensor, "R 2"]
    ) -> tuple[Float32[Tensor, "R 3"], Float32[Tensor, "R J 3"]]:
        """Predict the lean c_0 and ln A at k = 1 … K − 1, over the height; the lean is in proportion to A.

        Inputs are rows of `amplitude_inputs`; `wind` has ln speed and gust at each row.
        """
        return self._sizes(self._entered(inputs, 0) + self.enter.bias, wind)

    def _entered(self, columns: Float32[Tensor, "R C"], first: int) -> Float[Tensor, "R H"]:
        """Return the contribution of columns of the inputs, from the `first` on, to the first hidden layer."""
        some = slice(first, first + columns.shape[1])
        standard = ((columns - self.mean[some]) / self.deviation[some]).clamp_(-CLIP, CLIP)
        return functional.linear(standard, self.enter.weight[:, some])

    def _sizes(
        self, hidden: Float[Tensor, "R H"], wind: Float32[Tensor, "R 2"]
    ) -> tuple[Float32[Tensor, "R 3"], Float32[Tensor, "R J 3"]]:
        bent_size = 0.01  # share of the height: larger sways come with a lean that lowers the crown
        for block in self.blocks:
            hidden = hidden + block(hidden)
        hidden = self.head(hidden)
        sizes = self.sizes(hidden).view(len(hidden), self.num_frequencies, AXES)
        saturation = self.saturation(hidden).view(len(hidden), self.num_frequencies - 1, AXES)
        leant, dropped = self.second_order(hidden).float().T
        zeros, ones = torch.zeros_like(leant), torch.ones_like(leant)
        log_drag, log_gust = _log_wind(wind)
        bent = (saturation.float() + log_drag[:, None]).exp().clamp(*BENT)
        growth = log_drag[:, None] + (bent.tanh() / bent).log()  # ln of tanh(s d) / s
        growth = growth * torch.stack([ones, ones, 1 + leant.sigmoid()], dim=1)[:, None]
        log_amplitude = START + sizes[:, 1:] + growth + log_gust[:, None]
        size = (2 * (log_amplitude.detach() - log_gust[:, None])).exp().sum(dim=(1, 2)).sqrt()
        lean = sizes[:, 0] + torch.stack([zeros, zeros, dropped * size / bent_size], dim=1)
        return LEAN * lean * size[:, None], log_amplitude

    def of_tree(
        self, tree: TreeFeatures, foliage_values: Float32[Tensor, "V O"], wind: Float32[Tensor, "B 4"]
    ) -> tuple[Float32[Tensor, "V 3"], Float32[Tensor, "V J 3"]]:
        """Predict lean and ln A at all voxels, without gradients; `foliage_values` come from the foliage network."""
        own, means = _input_parts(tree, foliage_values, wind)
        entered, first = [], own.shape[1]
        for values, rows in means:  # shared inputs are computed once, not per voxel
            entered.append((self._entered(values, first), rows))
            first += values.shape[1]
        at_row = wind[tree.grids.levels[0].sample_of_row, :NUM_WIND]

        def of_band(start: int) -> tuple[Float32[Tensor, "R 3"], Float32[Tensor, "R J 3"]]:
            band = slice(start, start + BAND)
            hidden = self._entered(own[band], 0) + self.enter.bias
            for values, rows in entered:
                hidden += values[rows[band]]
            return self._sizes(hidden, at_row[band])

        bands = run_on_cores(partial(of_band, start) for start in range(0, len(own), BAND))
        lean, log_amplitude = zip(*bands, strict=True)
        wood = 1 - foliage_values[:, 0].clamp(0, 1)
        return torch.cat(lean), smooth_on_wood(torch.cat(log_amplitude), tree.links, wood)


def smooth_on_wood(
    values: Float32[Tensor, "V J 3"], links: Int64[Tensor, "L 2"], wood: Float32[Tensor, " V"]
) -> Float32[Tensor, "V J 3"]:
    """Return the x of least Σ (x - value)² + Σ WOOD_STIFFNESS w (x_row - x_bearer)², with w the wood of a link."""
    rows, bearers = links.T.numpy()
    stiffness = WOOD_STIFFNESS * (wood[rows] * wood[bearers]).sqrt().numpy().astype(np.float64)
    count = len(values)
    tied = csr_array((stiffness, (rows, bearers)), shape=(count, count))
    both = tied + tied.T
    system = csc_array(diags_array(1 + both.sum(axis=1)) - both)
    factors = splu(system, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
    solved = factors.solve(values.flatten(1).numpy().astype(np.float64))
    return torch.from_numpy(solved.astype(np.float32)).view_as(values)


def amplitude_inputs(
    tree: TreeFeatures, foliage_values: Float32[Tensor, "V O"], wind: Float32[Tensor, "B 4"]
) -> Float32[Tensor, "V I"]:
    """Return features of each voxel in the wind's frame and foliage values of it and of the stems that bear it, their
    means over its ancestors two and four levels up and over the tree, ln speed, and the gust. They do not depend on
    the grid's axes.
    """
    own, means = _input_parts(tree, foliage_values, wind)
    return torch.cat([own, *(values[rows] for values, rows in means)], dim=1)


def _input_parts(
    tree: TreeFeatures, foliage_values: Float32[Tensor, "V O"], wind: Float32[Tensor, "B 4"]
) -> tuple[Float32[Tensor, "V C"], list[tuple[Float32[Tensor, "_ _"], Int64[Tensor, " V"]]]]:
    """Return `amplitude_inputs` in parts: those of each voxel, and shared ones with the row of each voxel in them."""
    bearers = foliage_values[:, STEM][tree.chain].flatten(1)
    leafy = torch.cat([foliage_values[:, : ARM.start], foliage_values[:, ARM.stop :], bearers], dim=1)
    described = replace(
        tree,
        scalars=torch.cat([tree.scalars, tree.surface, leafy, tree.girth], dim=1),
        vectors=torch.cat([tree.vectors, foliage_values[:, None, ARM]], dim=1),
    )
    own, finest = node_features(described, wind), tree.grids.levels[0]
    means = [(pool_to(own, tree.grids, top), tree.grids.rows_above(top)) for top in CONTEXT]
    whole = torch.stack([own[rows].mean(dim=0) for rows in finest.sample_slices])
    return own, [*means, *((values, finest.sample_of_row) for values in (whole, wind[:, :NUM_WIND]))]


def mirror_inputs(inputs: Float32[Tensor, "R I"]) -> Float32[Tensor, "R I"]:
    """Return the `amplitude_inputs` of the mirrored tree: crosswind components change their sign."""
    signs = torch.ones(NUM_OWN)
    signs[NUM_OWN_SCALARS + NUM_OWN_VECTORS : NUM_OWN_SCALARS + 2 * NUM_OWN_VECTORS] = -1
    return inputs * torch.cat([signs.repeat(len(CONTEXT) + 2), torch.ones(NUM_WIND)])


def above_floor(log_amplitude: Float32[Tensor, "V J 3"], wind: Float32[Tensor, "W 2"]) -> Float32[Tensor, "V J 3"]:
    """Return A over the height, without the floor of ln A in training, so that still parts are exactly still.

    `wind` has ln speed and gust, one row for all or one per row.
    """
    return ((2 * log_amplitude).exp() - floor_of(wind)[:, None, None] ** 2).clamp_min(0).sqrt()


def _log_wind(wind: Float32[Tensor, "R 2"]) -> tuple[Float32[Tensor, "R 1"], Float32[Tensor, "R 1"]]:
    """Return ln of the drag, which is 1 at REFERENCE_SPEED, and ln of the gust."""
    return DRAG_EXPONENT * (wind[:, :1] - math.log(REFERENCE_SPEED)), wind[:, 1:].clamp_min(MIN_GUST).log()


def floor_of(wind: Float32[Tensor, "R 2"], share: float = FLOOR) -> Float32[Tensor, " R"]:
    """Scale a share of the height by the wind: in weak wind all is small, but the shape of the motion is the same."""
    log_drag, log_gust = _log_wind(wind)
    return share * (log_drag + log_gust)[:, 0].exp()
