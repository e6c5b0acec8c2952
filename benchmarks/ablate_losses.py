"""Small ablation of the paper's losses: L_DM alone, with L_LSS throughout or in two stages; frequencies scaled or not.

The paper's network with 24 channels instead of 128 and three levels instead of four, spectra at 16³ instead of 128³,
1,200 steps of batch 16 on small trees: enough to show the direction of an effect, not its size. Measured on DDIM
samples of held-out trees with averaged weights, over all frequencies: roughness between neighbours over the truth's,
the error of ln size by frequency, and the correlation of the voxels' sizes with the truth's.
"""

from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import torch

from benchmarks._machine import BRIEF, machine
from dynamictree.models import load_model
from dynamictree.models.paper.generate import PaperModel
from dynamictree.models.paper.network import PaperNetwork, PaperPreset
from dynamictree.models.paper.unet import UNetShape
from lab.dataset.sample import make_sample
from lab.dataset.shards import stored_tree, write_shard
from lab.paper.examples import PaperExample, paper_example
from lab.paper.sample_figures import sample_figures
from lab.paper.train import PaperTraining, train_paper

NUM_TREES, NUM_JUDGED, STEPS, BATCH, RESOLUTION = 16, 4, 14 if BRIEF else 1200, 16, 16
SMOOTHNESS_FROM = STEPS * 4 // 7  # like the paper's 40,000 of 70,000
DDIM_STEPS = 2 if BRIEF else 50
VARIANTS = {
    "L_DM": (STEPS, True),
    "both from the start": (0, True),
    "two stages": (SMOOTHNESS_FROM, True),
    "two stages, one size for all frequencies": (SMOOTHNESS_FROM, False),
}
PRESET = PaperPreset(
    resolution=RESOLUTION,
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
    ),
)


def run() -> dict[str, object]:
    torch.set_num_threads(1)
    stored = [stored_tree(make_sample(seed, "sapling"), resolutions=(128,)) for seed in range(NUM_TREES + NUM_JUDGED)]
    judged = [paper_example(tree, PRESET) for tree in stored[NUM_TREES:]]
    with TemporaryDirectory() as name:
        folder = Path(name)
        with (folder / "shard.safetensors").open("wb") as stream:
            write_shard([replace(tree, split="train") for tree in stored[:NUM_TREES]], stream)
        figures = {variant: _figures(_train(folder, variant), judged) for variant in VARIANTS}
    return {
        "value": figures,
        "unit": "ratio to the truth's; ln; correlation",
        "sizes": {"trees": NUM_TREES, "judged": NUM_JUDGED, "steps": STEPS, "batch": BATCH, "resolution": RESOLUTION},
        **machine("torch", "numpy"),
    }


def _train(folder: Path, variant: str) -> PaperNetwork:
    """Train a variant and return the averaged network."""
    smoothness_from, by_frequency = VARIANTS[variant]
    plan = PaperTraining(
        preset=PRESET,
        num_steps=STEPS,
        smoothness_from=smoothness_from,
        batch_size=BATCH,
        micro_trees=BATCH,
        learning_rate=1e-3,
        halve_every=STEPS // 3,
        by_frequency=by_frequency,
        save_every=10**6,
        figures_every_s=None,
        bf16=False,
    )
    own = folder / variant
    own.mkdir()
    train_paper(plan, [str(folder / "shard.safetensors")], own)
    model = load_model(str(own / "paper.safetensors"))
    assert isinstance(model, PaperModel)
    return model.network


def _figures(network: PaperNetwork, trees: list[PaperExample]) -> dict[str, float]:
    """Return the mean figures over trees."""
    rows = [sample_figures(network, tree, num_steps=DDIM_STEPS) for tree in trees]
    return {name: round(float(np.mean([row[name] for row in rows])), 3) for name in rows[0]}
