"""EDM's preconditioning: a network F becomes a denoiser D. Karras et al. 2022, arXiv 2206.00364, eq. 7."""

from collections.abc import Callable

from jaxtyping import Float32
from torch import Tensor


def preconditioned(
    network: Callable[[Tensor], Tensor], noisy: Float32[Tensor, "W J C"], sigma: Float32[Tensor, "W J 1"]
) -> Float32[Tensor, "W J C"]:
    """D(x; σ) = c_skip x + c_out F(c_in x) for data of unit variance: the expected clean signal."""
    scale = (1 + sigma.square()).sqrt()
    denoised: Float32[Tensor, "W J C"] = noisy / scale.square() + network(noisy / scale) * sigma / scale
    return denoised
