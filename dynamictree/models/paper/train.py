"""Preset `paper` from a dataset's shards: L_DM, then L_DM + L_LSS; on one process, or on many under `torchrun`.

A batch is pairs of a tree and a frequency. Each process takes `micro_batch` of them at a time and as many times a step
as make up the paper's 48. The tree's fine grid (512³ for spectra at 128³) is voxelised when its turn comes.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from functools import lru_cache, partial
from itertools import islice
from pathlib import Path

import numpy as np
import torch
import torch.distributed
from jaxtyping import Complex64, Float32, Int64
from safetensors.torch import save_file
from scipy.spatial import cKDTree
from torch import Tensor

from dynamictree.dataset.shards import StoredTree, iter_shard
from dynamictree.diffusion.channels import pack_channels
from dynamictree.diffusion.loss import nearest_voxels
from dynamictree.diffusion.schedule import linear_schedule
from dynamictree.errors import InputError
from dynamictree.models.paper.network import PaperNetwork, PaperPreset, PaperTraining, paper_loss
from dynamictree.sparse.level import Pyramid, batch_pyramids, pyramid
from dynamictree.training.progress import OnStep
from dynamictree.training.trainer import Course, Pace
from dynamictree.voxel.grid import VoxelGrid
from dynamictree.voxel.voxelize import voxelize

STORED = 128  # resolution of the spectra in the shards
MEASURED = 50  # trees that the sizes of frequencies are measured on
KEPT = 16  # trees that stay in memory once they are voxelised
MESH = ("vertices", "faces", f"r{STORED}.coords", f"r{STORED}.normals", f"r{STORED}.spectrum")


@dataclass(frozen=True, kw_only=True)
class PaperRun:
    """The resolved run. Learning rate, batch, and stages are the paper's; the rest of the pace is XCube's."""

    preset: PaperPreset = field(default_factory=PaperPreset)
    training: PaperTraining = field(default_factory=PaperTraining)
    resolution: int = 128  # of the spectrum; the condition's is as many times finer as the encoder halves it
    micro_batch: int = 1
    bf16: bool = True
    by_frequency: bool = True  # each frequency over its own size; else all over one, as the ablation wants
    save_every: int = 500
    seed: int = 0

    def pace(self, num_processes: int) -> Pace:
        """As many backward passes a step as give the paper's batch."""
        return Pace(
            num_steps=self.training.num_iterations,
            learning_rate=self.training.learning_rate,
            halve_every=self.training.halve_every,
            warmup_steps=1,
            weight_decay=1e-2,
            gradient_clip=0.5,
            ema_decay=0.9999,
            accumulate=max(1, round(self.training.batch_size / (self.micro_batch * num_processes))),
            bf16=self.bf16,
            save_every=self.save_every,
            seed=self.seed,
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class PaperExample:
    """One tree for the paper's network."""

    positions: Float32[Tensor, "X 3"]  # of the fine voxels, in [-1, 1]
    normals: Float32[Tensor, "X 3"]
    grids: Pyramid  # from the fine grid on
    spectrum: Complex64[Tensor, "V K 3"]  # over the height
    centres_m: Float32[np.ndarray, "V 3"]


def paper_example(stored: StoredTree, *, resolution: int, halvings: int, num_levels: int) -> PaperExample:
    """Voxelise the mesh finely, and bring the stored spectrum onto the grid that the encoder ends on."""
    mesh = stored.mesh()
    fine = voxelize(mesh, resolution << halvings)
    grids = pyramid(torch.from_numpy(fine.grid.coords.astype(np.int64)), halvings + num_levels)
    coords = grids.levels[halvings].coords.numpy().astype(np.int32)
    voxel_size_m = fine.grid.voxel_size_m * (1 << halvings)
    centres_m = (np.asarray(fine.grid.origin_m) + (coords + 0.5) * voxel_size_m).astype(np.float32)
    return PaperExample(
        positions=torch.from_numpy(((2 * fine.grid.coords + 1) / fine.grid.resolution - 1).astype(np.float32)),
        normals=torch.from_numpy(fine.normals),
        grids=grids,
        spectrum=torch.from_numpy(_pooled(stored, coords, resolution) / np.float32(mesh.height_m)),
        centres_m=centres_m,
    )


def train_paper(run: PaperRun, shards: Sequence[str], folder: Path, *, on_step: OnStep | None = None) -> PaperNetwork:
    """Train into a folder: `paper.checkpoint.safetensors` to go on from, `paper.safetensors` with the averages."""
    device = torch.device("cuda" if torch.cuda.is_available() else "cpu")
    torch.manual_seed(run.seed)
    network = PaperNetwork(run.preset).to(device)
    world = torch.distributed.get_world_size() if torch.distributed.is_initialized() else 1
    places = training_places(shards)
    trees = (tree for path in shards for tree in iter_shard(path, names=MESH) if tree.split == "train")
    scale = frequency_sizes(islice(trees, MEASURED), run.preset.num_frequencies)
    if not run.by_frequency:
        scale = one_size(scale)
    course, checkpoint = Course(network, run.pace(world)), folder / "paper.checkpoint.safetensors"
    course.resume(checkpoint)
    schedule = linear_schedule().to(device)
    example_at = lru_cache(KEPT)(partial(_example_at, run=run))

    def loss_of(rng: np.random.Generator) -> Float32[Tensor, ""]:
        chosen = [places[int(index)] for index in rng.integers(len(places), size=run.micro_batch)]
        examples = [example_at(place) for place in chosen]
        frequency = torch.from_numpy(rng.integers(0, run.preset.num_frequencies, run.micro_batch))
        rough = course.step < run.training.smoothness_from
        neighbours = None if rough else _neighbours(examples, run.training.smoothness.num_neighbours)
        return paper_loss(
            network,
            _clean(examples, frequency, scale).to(device),
            frequency.to(device),
            (
                torch.cat([one.positions for one in examples]).to(device),
                torch.cat([one.normals for one in examples]).to(device),
            ),
            batch_pyramids([one.grids for one in examples]).to(device),
            neighbours=None if neighbours is None else (neighbours[0].to(device), neighbours[1].to(device)),
            schedule=schedule,
            generator=torch.Generator().manual_seed(int(rng.integers(2**62))),
            smoothness=run.training.smoothness,
        )

    for step, loss in course.run(loss_of, checkpoint):
        if on_step is not None:
            on_step("paper", step, run.training.num_iterations, loss)
    if not torch.distributed.is_initialized() or torch.distributed.get_rank() == 0:
        average = {name: value.cpu().contiguous() for name, value in course.average.state_dict().items()}
        save_file({**average, "frequency_sizes": scale}, folder / "paper.safetensors")
    return network


def training_places(shards: Sequence[str]) -> list[tuple[str, int]]:
    """Shard and number in it of every tree for training.

    Raises:
        InputError: there is none.
    """
    places = [
        (path, number)
        for path in shards
        for number, tree in enumerate(iter_shard(path, names=()))
        if tree.split == "train"
    ]
    if not places:
        raise InputError("the shards hold no trees for training; bake some with `dynamictree dataset generate`")
    return places


def read_tree(path: str, number: int) -> StoredTree:
    """One tree of a shard."""
    return next(islice(iter_shard(path, names=MESH), number, None))


def frequency_sizes(trees: Iterable[StoredTree], num_frequencies: int) -> Float32[Tensor, " K"]:
    """Root mean square of the components at each frequency, over the height: what spectra are divided by."""
    power, count = np.zeros(num_frequencies), 0
    for tree in trees:
        height_m = float(np.ptp(tree.tensors["vertices"][:, 2]))
        relative = tree.spectrum(STORED).coefficients[:, :num_frequencies] / height_m
        power += (np.abs(relative) ** 2).mean(axis=(0, 2)) / 2
        count += 1
    return torch.from_numpy(np.sqrt(power / count).astype(np.float32))


def one_size(sizes: Float32[Tensor, " K"]) -> Float32[Tensor, " K"]:
    """For every frequency the size that all above the mean have together, which leaves them as uneven as they are."""
    return sizes[1:].square().mean().sqrt().expand(len(sizes)).contiguous()


def _example_at(place: tuple[str, int], run: PaperRun) -> PaperExample:
    return paper_example(
        read_tree(*place),
        resolution=run.resolution,
        halvings=len(run.preset.encoder_widths) - 1,
        num_levels=len(run.preset.unet.multipliers),
    )


def _pooled(stored: StoredTree, coords: np.ndarray, resolution: int) -> Complex64[np.ndarray, "V K 3"]:
    """Mean of the stored spectrum over each coarser voxel, in the order of `coords`; the nearest where none is."""
    factor = STORED // resolution
    if factor * resolution != STORED:
        raise InputError(f"the resolution is {resolution}; it must be {STORED} divided by a power of two")
    kept = stored.spectrum(STORED)
    origin_m, voxel_size_m = kept.grid.origin_m, kept.grid.voxel_size_m * factor
    coarse = VoxelGrid.from_coords(
        kept.grid.coords // factor, origin_m=origin_m, voxel_size_m=voxel_size_m, resolution=resolution
    )
    owner = coarse.rows_of(kept.grid.coords // factor)
    total = np.zeros((len(coarse), *kept.coefficients.shape[1:]), np.complex64)
    np.add.at(total, owner, kept.coefficients)
    mean = total / np.bincount(owner, minlength=len(coarse))[:, None, None]
    _, nearest = cKDTree(coarse.coords).query(coords)
    pooled: Complex64[np.ndarray, "V K 3"] = mean[nearest].astype(np.complex64)
    return pooled


def _clean(
    examples: Sequence[PaperExample], frequency: Int64[Tensor, " B"], scale: Float32[Tensor, " K"]
) -> Float32[Tensor, "V 6"]:
    rows = [pack_channels(one.spectrum[:, k]) / scale[k] for one, k in zip(examples, frequency.tolist(), strict=True)]
    return torch.cat(rows)


def _neighbours(
    examples: Sequence[PaperExample], num_neighbours: int
) -> tuple[Int64[Tensor, "V M"], Float32[Tensor, "V M"]]:
    rows, distances, start = [], [], 0
    for one in examples:
        found, far = nearest_voxels(one.centres_m, num_neighbours)
        rows.append(found + start)
        distances.append(far)
        start += len(one.centres_m)
    return torch.cat(rows), torch.cat(distances)
