"""The KL divergence of ACT's latent variable z, and samples of z."""

import torch
from torch import Tensor


def kl(mean: Tensor, log_variance: Tensor) -> Tensor:
    """KL(N(mean, variance) | N(0, 1)) in nats, summed over the components of z: (B, L), (B, L) -> (B,)."""
    return 0.5 * (mean.square() + log_variance.expm1() - log_variance).sum(-1)


def sample(mean: Tensor, log_variance: Tensor, generator: torch.Generator) -> Tensor:
    """A sample z ~ N(mean, variance) with gradients of both: (B, L), (B, L) -> (B, L)."""
    noise = torch.randn(mean.shape, generator=generator, device=mean.device)
    return mean + (0.5 * log_variance).exp() * noise
