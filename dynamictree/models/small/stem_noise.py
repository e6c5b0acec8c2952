"""Noise that moves as a tree does: stems rotate about their bases, partly together and partly each by itself.

A stem rotates by θ = g A (d × F) / L, with d and L the direction and length from its base to its tip, A the predicted
size of its tip's motion, and g = tanh(k L / (OWN_HEIGHTS H)) the part of the motion that is its own (1 for the trunk):
below its natural frequency a branch follows what bears it. F is a normal force, of whose power all stems share a part.
A voxel at x moves by all rotations between it and the root, u = Σ θ × (x - b), with b the stems' bases. The noise is u
over its expected size, per axis. So the sampler need not learn that a tree is smooth and that its stems rotate.
"""

from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Float32, Int64
from scipy.sparse import csr_array, eye_array
from torch import Tensor

from dynamictree.models.small.features import Stems, TreeFeatures
from dynamictree.sparse.matrices import SparseRows, pool_matrix, sparse_rows

OWN_HEIGHTS = 2.0
"""Stem length times bin at which most of the motion is the stem's own [heights] (docs/decisions/diffusion.md)."""
LEAF_HEIGHTS = 0.2
"""Length of a stem whose motion is as much its own as a leaf's [heights]. The parts measured of leaves (0.40, 0.71 and
0.87 of the power at k = 4, 8 and 12) ask for 0.3, with which 14 training trees are 4 % rougher."""


@dataclass(frozen=True, kw_only=True, eq=False)
class StemNoise:
    """Noise of one tree in one wind; lengths are in voxels, in the wind's frame."""

    stems: Stems
    place: Float32[Tensor, "V 3"]
    direction: Float32[Tensor, "S 3"]
    turn: Float32[Tensor, "S J"]  # rotation per unit of force
    bearers: SparseRows  # [S, S]: each stem and all that bear it
    size: Float32[Tensor, "V J 3"]  # expected size of u
    pool: SparseRows  # [W, V]: means over nodes

    def draw(self, common_share: Float32[Tensor, " J"], generator: torch.Generator) -> Float32[Tensor, "S J 2 3"]:
        """Draw the stems' forces of unit variance, real and imaginary; `common_share` of their power is one force."""
        shape = (len(self.direction), len(common_share), 2, 3)
        whole, own = (torch.randn(count, *shape[1:], generator=generator) for count in (1, shape[0]))
        share = common_share[:, None, None]
        return share.sqrt() * whole + (1 - share).sqrt() * own

    def field(self, forces: Float32[Tensor, "S J 2 3"]) -> Float32[Tensor, "V J 6"]:
        """Return the voxels' noise of unit variance under forces."""
        return (self._moved(forces) / self.size[:, :, None]).flatten(2)

    def of_bins(self, bins: Int64[Tensor, " F"]) -> "StemNoise":
        """Return the noise of some frequencies, given as indices."""
        return replace(self, turn=self.turn[:, bins], size=self.size[:, bins])

    def _moved(self, forces: Float32[Tensor, "S J P 3"]) -> Float32[Tensor, "V J P 3"]:
        turn = torch.linalg.cross(self.direction[:, None, None], forces) * self.turn[:, :, None, None]
        shift = torch.linalg.cross(self.place[self.stems.base][:, None, None], turn)
        turn, shift = self.bearers.apply(torch.stack([turn, shift], dim=1))[self.stems.of_voxel].unbind(dim=1)
        moved: Tensor = shift + torch.linalg.cross(turn, self.place[:, None, None])
        return moved


def stem_noise(
    tree: TreeFeatures,
    log_amplitude: Float32[Tensor, "V J 3"],
    wind: Float32[Tensor, "1 4"],
    common_share: Float32[Tensor, " J"],
    leaf: Float32[Tensor, " V"],
    top: int,
) -> StemNoise:
    """Build the noise of a tree whose nodes are on level `top`; `leaf` is the share of leaf per voxel."""
    assert tree.stems is not None, "nodes have no stems"
    stems, cosine, sine = tree.stems, wind[0, 2], wind[0, 3]
    east, north, up = tree.grids.levels[0].coords.float().T
    place = torch.stack([cosine * east + sine * north, cosine * north - sine * east, up], dim=1)
    arm = place[stems.tip] - place[stems.base]
    length = arm.norm(dim=1, keepdim=True).clamp_min(1)
    bins = torch.arange(1, len(common_share) + 1)
    height = up.max() - up.min() + 1
    own = torch.tanh(
        bins * torch.maximum(length, LEAF_HEIGHTS * height * leaf[stems.tip, None]) / (OWN_HEIGHTS * height)
    )
    own[stems.is_trunk] = 1.0
    bearers = _bearers(stems)
    noise = StemNoise(
        stems=stems,
        place=place,
        direction=arm / length,
        turn=own * log_amplitude[stems.tip].exp().norm(dim=2) / length,
        bearers=sparse_rows(bearers),
        size=torch.ones_like(log_amplitude),
        pool=sparse_rows(pool_matrix(tree.grids, top, 0)),
    )
    units = torch.eye(3).expand(len(arm), len(bins), 3, 3)
    together = noise._moved(units).square().sum(dim=2)
    power = common_share[:, None] * together + (1 - common_share[:, None]) * _apart(noise, bearers)
    least = 1e-6 * power.amax(dim=(0, 2), keepdim=True)  # where nothing moves, as at the root, noise fades out
    return replace(noise, size=(power + least).sqrt())


def _bearers(stems: Stems) -> csr_array:
    size = len(stems.base)
    borne = np.flatnonzero(~stems.is_trunk.numpy())
    bearer = stems.of_voxel[stems.base].numpy()[borne]
    step = csr_array((np.ones(len(borne), np.float32), (borne, bearer)), shape=(size, size))
    total = further = csr_array(eye_array(size, dtype=np.float32, format="csr"))
    while (further := csr_array(step @ further)).nnz:
        total = total + further
    return csr_array(total)


def _apart(noise: StemNoise, bearers: csr_array) -> Float32[Tensor, "V J 3"]:
    """Return E u² if each stem had a force of its own: Σ_j ((d × e_j) × r)_i² = (d·r)² - 2 d_i r_i d·r + d_i² r²."""
    paths = bearers[noise.stems.of_voxel.numpy()].tocoo()
    voxel, stem = torch.from_numpy(paths.row.astype(np.int64)), torch.from_numpy(paths.col.astype(np.int64))
    d, r = noise.direction[stem], noise.place[voxel] - noise.place[noise.stems.base[stem]]
    along = (d * r).sum(dim=1, keepdim=True)
    factors = along.square() - 2 * d * r * along + d.square() * r.square().sum(dim=1, keepdim=True)
    of_axes = [csr_array((axis.numpy(), (paths.row, paths.col)), shape=paths.shape) for axis in factors.T]
    squares = noise.turn.square().numpy()
    return torch.stack([torch.from_numpy((axis @ squares).astype(np.float32)) for axis in of_axes], dim=2)
