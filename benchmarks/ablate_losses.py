"""The paper's losses in small: L_DM alone, L_DM + L_LSS throughout, and in two stages; sizes of frequencies on and off.

The paper's network with 24 channels instead of 128 and three levels instead of four, spectra at 16³ instead of 128³,
1,200 steps of batch 16 on small trees: enough to tell the direction of an effect, not its size. Judged by DDIM samples
of trees that were not trained on, averages of the weights, all frequencies: roughness between neighbours over the
truth's, the error of ln size by frequency, and how well the voxels' sizes agree with the truth's.
"""

from dataclasses import replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import torch
from jaxtyping import Float32
from safetensors.torch import load_file
from torch import Tensor

from benchmarks._machine import machine
from dynamictree.dataset.sample import make_sample
from dynamictree.dataset.shards import StoredTree, store, write_shard
from dynamictree.diffusion.channels import pack_channels
from dynamictree.diffusion.loss import nearest_voxels
from dynamictree.diffusion.sampler import sample_ddim
from dynamictree.diffusion.schedule import linear_schedule
from dynamictree.models.paper.network import PaperNetwork, PaperPreset, PaperTraining
from dynamictree.models.paper.train import PaperExample, PaperRun, paper_example, train_paper
from dynamictree.models.paper.unet import UNetShape

NUM_TREES, NUM_JUDGED, STEPS, BATCH, RESOLUTION = 16, 4, 1200, 16, 16
SMOOTHNESS_FROM = STEPS * 4 // 7  # as the paper's 40,000 of 70,000
DDIM_STEPS = 50
VARIANTS = {
    "L_DM": (STEPS, True),
    "both from the start": (0, True),
    "two stages": (SMOOTHNESS_FROM, True),
    "two stages, one size for all frequencies": (SMOOTHNESS_FROM, False),
}
PRESET = PaperPreset(
    encoder_base=8,
    encoder_widths=(8, 16),
    unet=UNetShape(
        base=24,
        multipliers=(1, 2, 2),
        num_blocks=1,
        num_skips=2,
        attention_levels=(2,),
        num_heads=2,
        num_groups=8,
        embedding=64,
        resample_blocks=False,
    ),
)


def run() -> dict[str, object]:
    torch.set_num_threads(1)
    stored = [store(make_sample(seed, "sapling"), resolutions=(128,)) for seed in range(NUM_TREES + NUM_JUDGED)]
    judged = [_example(tree) for tree in stored[NUM_TREES:]]
    with TemporaryDirectory() as name:
        folder = Path(name)
        with (folder / "shard.safetensors").open("wb") as stream:
            write_shard([replace(tree, split="train") for tree in stored[:NUM_TREES]], stream)
        found = {variant: _judged(*_trained(folder, variant), judged) for variant in VARIANTS}
    return {
        "value": found,
        "unit": "ratio to the truth's; ln; correlation",
        "sizes": {"trees": NUM_TREES, "judged": NUM_JUDGED, "steps": STEPS, "batch": BATCH, "resolution": RESOLUTION},
        **machine("torch", "numpy"),
    }


def _trained(folder: Path, variant: str) -> tuple[PaperNetwork, Float32[Tensor, " K"]]:
    """The averaged network, and what its spectra are divided by."""
    smoothness_from, by_frequency = VARIANTS[variant]
    training = PaperTraining(
        num_iterations=STEPS,
        smoothness_from=smoothness_from,
        batch_size=BATCH,
        learning_rate=1e-3,
        halve_every=STEPS // 3,
    )
    plan = PaperRun(
        preset=PRESET,
        training=training,
        resolution=RESOLUTION,
        micro_batch=BATCH,
        by_frequency=by_frequency,
        save_every=10**6,
        bf16=False,
    )
    own = folder / variant
    own.mkdir()
    network = train_paper(plan, [str(folder / "shard.safetensors")], own)
    weights = load_file(own / "paper.safetensors")
    sizes = weights.pop("frequency_sizes")
    network.load_state_dict(weights)
    return network, sizes


def _example(tree: StoredTree) -> PaperExample:
    halvings, levels = len(PRESET.encoder_widths) - 1, len(PRESET.unet.multipliers)
    return paper_example(tree, resolution=RESOLUTION, halvings=halvings, num_levels=levels)


@torch.no_grad()
def _judged(network: PaperNetwork, sizes: Float32[Tensor, " K"], trees: list[PaperExample]) -> dict[str, float]:
    """Means over trees and frequencies."""
    rough, size, agreement = [], [], []
    for tree in trees:
        condition = network.encoder(tree.positions, tree.normals, tree.grids)
        rows, _ = nearest_voxels(tree.centres_m, 5)
        energy = []
        for k in range(1, PRESET.num_frequencies):
            truth = pack_channels(tree.spectrum[:, k])
            predict = partial(_predict, network, tree, condition, k)
            start = torch.randn(truth.shape, generator=torch.Generator().manual_seed(k))
            drawn = sizes[k] * sample_ddim(predict, start, linear_schedule(), num_steps=DDIM_STEPS)
            rough.append(_roughness(drawn, rows) / _roughness(truth, rows))
            size.append(abs(float((drawn.square().mean().log() - truth.square().mean().log()) / 2)))
            energy.append(torch.stack([one.square().sum(dim=1) for one in (drawn, truth)]))
        sizes_of = torch.stack(energy).sum(dim=0).log().numpy()
        agreement.append(np.corrcoef(sizes_of)[0, 1])
    return {
        "roughness_ratio": round(float(np.mean(rough)), 2),
        "ln_size_error": round(float(np.mean(size)), 2),
        "log_amplitude_correlation": round(float(np.mean(agreement)), 3),
    }


def _predict(
    network: PaperNetwork, tree: PaperExample, condition: Tensor, k: int, noisy: Tensor, step: int
) -> Float32[Tensor, "V 6"]:
    noise: Tensor = network(noisy, torch.tensor([step]), torch.tensor([k]), condition, tree.grids)
    return noise


def _roughness(field: Float32[Tensor, "V 6"], rows: Tensor) -> float:
    across = torch.linalg.vector_norm(field[:, None] - field[rows], dim=-1).mean()
    return float(across / torch.linalg.vector_norm(field, dim=-1).mean())
