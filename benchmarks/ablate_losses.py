"""The paper's losses in small: L_DM alone, L_DM + L_LSS throughout, and in two stages; sizes of frequencies on and off.

The paper's network at 8 channels instead of 128, spectra at 16³ instead of 128³, 24 steps of batch 4 on four small
trees: enough to tell the direction of an effect, not its size. Judged by DDIM samples of one of the trees: roughness
between neighbours over the truth's, and the error of ln size by frequency.
"""

from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import torch

from benchmarks._machine import machine
from dynamictree.dataset.sample import make_sample
from dynamictree.dataset.shards import store, write_shard
from dynamictree.diffusion.loss import nearest_voxels
from dynamictree.diffusion.paper import PaperNetwork, PaperTraining, paper_preset
from dynamictree.diffusion.sample import sample_ddim
from dynamictree.diffusion.schedule import linear_schedule
from dynamictree.diffusion.small import pack_channels
from dynamictree.training.paper import PaperExample, PaperRun, frequency_sizes, one_size, paper_example, train_paper

NUM_TREES, STEPS, BATCH, WIDTH, RESOLUTION = 4, 120, 4, 8, 16
FREQUENCIES = (1, 3, 6)
DDIM_STEPS = 20


def run() -> dict[str, object]:
    torch.set_num_threads(1)
    stored = [store(make_sample(seed, "sapling"), resolutions=(128,)) for seed in range(1, NUM_TREES + 1)]
    two = STEPS * 4 // 7
    variants = {
        "L_DM": (STEPS, True),
        "both from the start": (0, True),
        "two stages": (two, True),
        "two stages, one size for all frequencies": (two, False),
    }
    found = {}
    with TemporaryDirectory() as folder:
        shard = Path(folder) / "shard.safetensors"
        with shard.open("wb") as stream:
            write_shard([replace(tree, split="train") for tree in stored], stream)
        sizes = frequency_sizes(stored, 16)
        for name, (smoothness_from, by_frequency) in variants.items():
            run_of = PaperRun(
                preset=paper_preset(WIDTH),
                training=PaperTraining(
                    num_iterations=STEPS, smoothness_from=smoothness_from, batch_size=BATCH, learning_rate=1e-3
                ),
                resolution=RESOLUTION,
                by_frequency=by_frequency,
                save_every=10**6,
            )
            network = train_paper(run_of, [str(shard)], _made(Path(folder) / name))
            example = paper_example(stored[0], resolution=RESOLUTION, halvings=2, num_levels=4)
            own = sizes if by_frequency else one_size(sizes)
            found[name] = _judged(network, example, own)
    return {
        "value": found,
        "unit": "ratio to the truth's; ln",
        "sizes": {"trees": NUM_TREES, "steps": STEPS, "batch": BATCH, "width": WIDTH, "resolution": RESOLUTION},
        **machine("torch", "numpy"),
    }


def _made(folder: Path) -> Path:
    folder.mkdir()
    return folder


@torch.no_grad()
def _judged(network: PaperNetwork, example: PaperExample, sizes: torch.Tensor) -> dict[str, float]:
    condition = network.encoder(example.positions, example.normals, example.grids)
    rows, _ = nearest_voxels(example.centres_m, 5)
    rough, size = [], []
    for k in FREQUENCIES:
        truth = pack_channels(example.spectrum[:, k]) / sizes[k]
        frequency = torch.tensor([k])

        def predict(noisy: torch.Tensor, step: int, frequency: torch.Tensor = frequency) -> torch.Tensor:
            predicted: torch.Tensor = network(noisy, torch.tensor([step]), frequency, condition, example.grids)
            return predicted

        start = torch.randn(truth.shape, generator=torch.Generator().manual_seed(k))
        drawn = sample_ddim(predict, start, linear_schedule(), num_steps=DDIM_STEPS)
        rough.append(_roughness(drawn, rows) / _roughness(truth, rows))
        size.append(float((drawn.square().mean().log() - truth.square().mean().log()) / 2))
    return {"roughness_ratio": round(float(np.mean(rough)), 2), "ln_size_error": round(float(np.mean(size)), 2)}


def _roughness(field: torch.Tensor, rows: torch.Tensor) -> float:
    across = torch.linalg.vector_norm(field[:, None] - field[rows], dim=-1).mean()
    return float(across / torch.linalg.vector_norm(field, dim=-1).mean())
