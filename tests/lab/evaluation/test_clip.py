"""CLIP distances. Loading is tested on a ViT-B/32 of the true shape with random weights, distances on a small tower."""

import numpy as np
import pytest
import torch
from safetensors.torch import save_file

from dynamictree.errors import CheckpointError, InputError
from lab.dataset.sample import make_sample
from lab.evaluation.clip import ClipEmbedder, load_clip
from lab.evaluation.frame_distances import embed_pictures, frame_distances, motion_distances

transformers = pytest.importorskip("transformers", reason="the extra `evaluate` is not installed")


@pytest.fixture(scope="module")
def embedder() -> ClipEmbedder:
    torch.manual_seed(0)
    config = transformers.CLIPVisionConfig(
        hidden_size=64, intermediate_size=64, num_hidden_layers=2, num_attention_heads=2, projection_dim=32
    )
    return ClipEmbedder(transformers.CLIPVisionModelWithProjection(config))


def picture(seed: int) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, 256, (224, 224, 3)).astype(np.uint8)


@pytest.mark.slow
def test_the_weights_are_those_of_the_file_and_of_vit_b_32(tmp_path) -> None:
    """The file as it is published: with another tower's tensors, and positions among the weights."""
    with torch.device("meta"):
        shape = transformers.CLIPVisionModelWithProjection(transformers.CLIPVisionConfig()).state_dict()
    generator = torch.Generator().manual_seed(0)
    weights = {name: 0.02 * torch.randn(value.shape, generator=generator) for name, value in shape.items()}
    others = {"vision_model.embeddings.position_ids": torch.arange(50)[None], "logit_scale": torch.ones(1)}
    save_file({**weights, **others}, tmp_path / "model.safetensors")
    loaded = load_clip(tmp_path)
    assert sum(one.numel() for one in loaded.network.parameters()) == 87_849_216
    assert all(torch.equal(value, weights[name]) for name, value in loaded.network.state_dict().items())
    assert not loaded.network.training
    (row,) = embed_pictures(loaded, [picture(0)])
    assert row.shape == (512,)
    assert float(row.norm()) == pytest.approx(1)


def test_clip_i_looks_at_the_view_and_clip_t_at_the_frame_before(embedder: ClipEmbedder) -> None:
    assert frame_distances(embedder, picture(0), [picture(0)] * 2) == pytest.approx((0, 0), abs=1e-5)
    near, between = frame_distances(embedder, picture(0), [picture(1)] * 3)
    assert near > 1e-4
    assert between == pytest.approx(0, abs=1e-5)
    forth = frame_distances(embedder, picture(0), [picture(0), picture(1), picture(0)])
    assert forth[0] == pytest.approx(near / 3, rel=1e-2)
    assert forth[1] == pytest.approx(near, rel=1e-2)


def test_a_wide_picture_is_cut_to_its_middle(embedder: ClipEmbedder) -> None:
    wide = np.concatenate([picture(5)[:, :50], picture(0), picture(6)[:, :50]], axis=1)
    assert frame_distances(embedder, picture(0), [wide])[0] == pytest.approx(0, abs=1e-5)


def test_a_tree_that_moves_more_is_farther_from_its_rest(embedder: ClipEmbedder) -> None:
    sample = make_sample(3, "sapling")
    still = motion_distances(embedder, sample.mesh, np.zeros_like(sample.coefficients), num_frames=2)
    moving = motion_distances(embedder, sample.mesh, sample.coefficients, num_frames=2)
    assert still == pytest.approx((0, 0), abs=1e-5)
    assert min(moving) > 1e-6


def test_other_weights_are_refused(tmp_path) -> None:
    with pytest.raises(InputError, match="no file"):
        load_clip(tmp_path)
    (tmp_path / "model.safetensors").write_bytes(b"no weights")
    with pytest.raises(CheckpointError, match="no safetensors file"):
        load_clip(tmp_path)
    save_file({"vision_model.pre_layrnorm.weight": torch.zeros(1024)}, tmp_path / "model.safetensors")
    with pytest.raises(CheckpointError, match=r"differs from ViT-B/32 in \d+ tensors"):
        load_clip(tmp_path / "model.safetensors")
