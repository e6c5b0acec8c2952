"""What a diffusion network predicts, and the clean signal that it implies: noise ε, or velocity v = √ᾱ ε − √(1 − ᾱ) x₀.

Velocity is Salimans and Ho's (2022, arXiv 2202.00512): its error is never divided, where that of ε is divided by √ᾱ.
"""

from typing import Literal

from jaxtyping import Float
from torch import Tensor

Prediction = Literal["noise", "velocity"]


def prediction_target(
    clean: Float[Tensor, "*batch C"],
    noise: Float[Tensor, "*batch C"],
    alpha_bar: Float[Tensor, "..."],
    prediction: Prediction,
) -> Float[Tensor, "*batch C"]:
    """What a perfect network says of √ᾱ x₀ + √(1 − ᾱ) ε."""
    if prediction == "noise":
        return noise
    return alpha_bar.sqrt() * noise - (1 - alpha_bar).sqrt() * clean


def predicted_clean(
    noisy: Float[Tensor, "*batch C"],
    predicted: Float[Tensor, "*batch C"],
    alpha_bar: Float[Tensor, "..."],
    prediction: Prediction,
) -> Float[Tensor, "*batch C"]:
    """The clean signal x₀ that a prediction implies: (x − √(1 − ᾱ) ε) / √ᾱ, or √ᾱ x − √(1 − ᾱ) v."""
    if prediction == "noise":
        return (noisy - (1 - alpha_bar).sqrt() * predicted) / alpha_bar.sqrt()
    return alpha_bar.sqrt() * noisy - (1 - alpha_bar).sqrt() * predicted
