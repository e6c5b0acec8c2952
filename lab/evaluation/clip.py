"""CLIP's image tower, ViT-B/32, for CLIP-I and CLIP-T (paper section 6).

The tower is that of `transformers` (extra `lab`); the user supplies the weights file, nothing is downloaded.
"""

from pathlib import Path
from typing import TYPE_CHECKING

import torch
from jaxtyping import Float32
from safetensors import SafetensorError, safe_open
from torch import Tensor

from dynamictree.errors import CheckpointError, InputError

if TYPE_CHECKING:
    from transformers import CLIPVisionModelWithProjection

MEAN = (0.48145466, 0.4578275, 0.40821073)  # mean colour of CLIP's training pictures
DEVIATION = (0.26862954, 0.26130258, 0.27577711)
TOWER = ("vision_model.", "visual_projection.")


class ClipEmbedder:
    """Embeds pictures with CLIP's image tower."""

    def __init__(self, network: "CLIPVisionModelWithProjection") -> None:
        self.network = network.train(mode=False).requires_grad_(False)

    def features(self, pixels: Float32[Tensor, "P 3 S S"]) -> Float32[Tensor, "P D"]:
        """Compute features of pictures with values in [0, 1]."""
        mean, deviation = (torch.tensor(one)[:, None, None] for one in (MEAN, DEVIATION))
        image_embeds: Tensor = self.network(pixel_values=(pixels - mean) / deviation).image_embeds
        return image_embeds


def load_clip(path: Path) -> ClipEmbedder:
    """Load ViT-B/32 from a file, or from a folder with `model.safetensors`; a text tower in it is ignored.

    Raises:
        InputError: the file does not exist, or `transformers` is not installed.
        CheckpointError: the file does not have the weights of CLIP's ViT-B/32.
    """
    file = path / "model.safetensors" if path.is_dir() else path
    wanted = "give model.safetensors of openai/clip-vit-base-patch32"
    if not file.is_file():
        raise InputError(f"there is no file {file}; {wanted}")
    try:
        from transformers import CLIPVisionConfig, CLIPVisionModelWithProjection
    except ImportError as error:
        raise InputError("CLIP needs the package transformers; install dynamictree[lab]") from error
    try:
        with safe_open(file, framework="pt") as stored:
            names = [name for name in stored.keys() if name.startswith(TOWER)]  # noqa: SIM118 no mapping
            weights = {name: stored.get_tensor(name).float() for name in names if not name.endswith("position_ids")}
    except SafetensorError as error:
        raise CheckpointError(f"{file} is no safetensors file ({error}); {wanted}") from error
    with torch.device("meta"):
        network = CLIPVisionModelWithProjection(CLIPVisionConfig())  # ViT-B/32 is the default
    needed = {name: tuple(value.shape) for name, value in network.state_dict().items()}
    shapes = {name: tuple(value.shape) for name, value in weights.items()}
    if needed != shapes:
        wrong = sorted(name for name in needed.keys() | shapes if needed.get(name) != shapes.get(name))
        raise CheckpointError(f"{file} differs from ViT-B/32 in {len(wrong)} tensors, first {wrong[0]!r}; {wanted}")
    # position ids are not stored as weights: build the network in memory, then load its weights
    network = CLIPVisionModelWithProjection(CLIPVisionConfig())
    network.load_state_dict(weights)
    return ClipEmbedder(network)
