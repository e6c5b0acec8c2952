"""Locality of a push: modes span the whole tree, so each group of forces has a weight per voxel.

    u(p) = Σ_g w_g(p) Re Σ_k φ_k(p) q_{g,k},        w_g(p) = exp(−(c_g(p) / falloff)²)

The cost c_g(p) is the length of the cheapest way from the poked voxel to p along the tree, where

- going outward from where the push began is free: what the poked branch carries rides with it;
- going towards the root costs its length: ancestors move less, the nearer to the root the less;
- going outward again, after any way rootward, costs `OUTWARD` times its length: other branches barely move;
- going around a stem costs `SIDEWAYS` times its length: a stem's faces move together.

Another tree is no way, and twigs that touch are none: an edge between voxels that the wind moves differently is longer
by how much they differ.
"""

from dataclasses import dataclass

import numpy as np
import scipy  # its parts come in when they are used: the service starts without them
from jaxtyping import Float32, Float64, Int

from dynamictree.errors import InputError
from dynamictree.modal.system import ModalSystem
from dynamictree.requests import SwingParams
from dynamictree.voxel.graph import root_distance, stand_graph

OUTWARD = 32.0
SIDEWAYS = 0.25
STRANGER = 1000.0  # an edge is as many times longer whose ends move as unlike as strangers do; cubed for less
FALLOFF_SHARE = 0.15  # of the tree's height: the default falloff
REACH = 3.0  # falloffs, beyond which a weight (1e-4) is zero


@dataclass(frozen=True, kw_only=True)
class Branching:
    """Graph of paths between the voxels; prepared once per spectrum, used once per push."""

    ways: "scipy.sparse.csr_array"  # [2V, 2V]; rows V to 2V - 1 are the same voxels after a way towards the root


def default_falloff_m(system: ModalSystem) -> float:
    """Default falloff of a push [m]."""
    levels = int(np.ptp(system.grid.coords[:, 2])) + 1
    return FALLOFF_SHARE * levels * system.grid.voxel_size_m


def chosen_falloff_m(system: ModalSystem, params: SwingParams) -> float | None:
    """Falloff of a request [m]; None where a push moves the whole tree."""
    return None if params.locality == "none" else params.falloff_m or default_falloff_m(system)


def branching(system: ModalSystem) -> Branching:
    """Find the branching structure from the voxels and their motion."""
    edges = stand_graph(system.grid, system.tree).tocoo()
    start, end = edges.row, edges.col
    length = edges.data * (1 + STRANGER * unlikeness(system, start, end) ** 3)  # [E]
    num_voxels = len(system.grid)
    stretched = scipy.sparse.csr_array((length, (start, end)), shape=(num_voxels, num_voxels))
    out = root_distance(stretched, system.grid, system.tree).astype(np.float64)
    rise = out[end] - out[start]
    outward, rootward = np.maximum(rise, 0), np.maximum(-rise, 0)
    around = SIDEWAYS * np.maximum(length - np.abs(rise), 0) + 1e-6  # a stored zero would be no edge
    begun = rise >= 0
    rows = np.concatenate([start[begun], start[~begun], start + num_voxels])
    columns = np.concatenate([end[begun], end[~begun] + num_voxels, end + num_voxels])
    costs = np.concatenate([around[begun], (rootward + around)[~begun], rootward + OUTWARD * outward + around])
    ways = scipy.sparse.csr_array((costs, (rows, columns)), shape=(2 * num_voxels, 2 * num_voxels))
    return Branching(ways=ways)


def poke_weights(tree: Branching, seed_voxel: int, falloff_m: float) -> Float32[np.ndarray, " V"]:
    """Weight of each voxel in the response to a push at one voxel: 1 there and outward of it.

    Raises:
        InputError: no such voxel, or the falloff is no length.
    """
    num_voxels = tree.ways.shape[0] // 2
    if not 0 <= seed_voxel < num_voxels:
        raise InputError(f"voxel {seed_voxel} does not exist; the spectrum has voxels 0 to {num_voxels - 1}")
    if not (np.isfinite(falloff_m) and falloff_m > 0):
        raise InputError(f"falloff_m is {falloff_m}; it must be positive and finite")
    from scipy.sparse.csgraph import dijkstra

    cost = dijkstra(tree.ways, indices=np.array([seed_voxel]), limit=REACH * falloff_m)[0]  # [2V]
    nearest = np.minimum(cost[:num_voxels], cost[num_voxels:])
    weights: Float32[np.ndarray, " V"] = np.exp(-((nearest / falloff_m) ** 2)).astype(np.float32)
    return weights


def unlikeness(
    system: ModalSystem,
    start: Int[np.ndarray, " E"],
    end: Int[np.ndarray, " E"],
    *,
    strength_power: float = 0.0,
    floor: float = 0.0,
) -> Float64[np.ndarray, " E"]:
    """How unlike two voxels move: |φ_a − φ_b|² / |φ_a||φ_b|, at most 1, with modes scaled to comparable strengths.

    The slow modes are the trunk's, which all twigs share; it is by the fast ones that two twigs differ. Of touching
    voxels on dataset trees, those of one stem have a median of 0.003, leaves on it of 0.1, those of two branches of 1.

    Args:
        system: the modes.
        start: one voxel of each pair.
        end: the other.
        strength_power: of a mode's strength that is left after the scaling: 0 makes all modes as strong, 1 scales none.
        floor: share of the tree's mean |φ| below which a voxel stands still, and is like its neighbours.
    """
    strength = np.sqrt((np.abs(system.shapes) ** 2).mean(axis=(0, 2), keepdims=True))  # [1, M, 1]
    scaled = system.shapes * np.maximum(strength, np.finfo(np.float32).tiny) ** (strength_power - 1)
    flat = scaled.astype(np.complex64).reshape(len(system.grid), -1).view(np.float32)  # [V, 6M]
    norm = np.linalg.norm(flat, axis=1)
    apart = np.linalg.norm(flat[start] - flat[end], axis=1)
    least = max(floor**2 * float((norm**2).mean()), float(np.finfo(np.float32).tiny))
    unlike: Float64[np.ndarray, " E"] = np.minimum(apart**2 / np.maximum(norm[start] * norm[end], least), 1)
    return unlike.astype(np.float64)
