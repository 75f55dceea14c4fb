"""The categorical quantizer (Section III-A): logits of G groups of n_c codes -> one code per group."""

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from acgd.students.acgd.settings import ACGDConfig


def logits_by_distance(z_e: Tensor, codes: Tensor) -> Tensor:
    """Negative squared distances of z_e (B, G, n_q) to codes (G, n_c, n_q) -> (B, G, n_c).

    The nearest code is the likeliest.
    """
    dot = torch.einsum("bgq,gcq->bgc", z_e, codes)
    return 2 * dot - z_e.square().sum(-1, keepdim=True) - codes.square().sum(-1)


def onehot(codes: Tensor, n_c: int) -> Tensor:
    """One-hot vectors of codes (...) long -> (..., n_c) float32."""
    return F.one_hot(codes, n_c).float()


def sample(logits: Tensor, generator: torch.Generator) -> tuple[Tensor, Tensor]:
    """Straight-through sample c ~ M(sigma(z_e)) (Section III-A).

    logits (B, G, n_c) -> one-hot with the gradient of sigma(logits) (B, G, n_c), codes (B, G).
    """
    probabilities = logits.float().softmax(-1)
    flat = probabilities.detach().flatten(0, 1)
    codes = torch.multinomial(flat, 1, generator=generator).view(logits.shape[:-1])
    return onehot(codes, logits.shape[-1]) - probabilities.detach() + probabilities, codes


def most_likely(logits: Tensor) -> tuple[Tensor, Tensor]:
    """The likeliest codes, used in evaluation. logits (B, G, n_c) -> one-hot (B, G, n_c), codes (B, G)."""
    codes = logits.argmax(-1)
    return onehot(codes, logits.shape[-1]), codes


def perplexity(codes: Tensor, n_c: int) -> Tensor:
    """Effective number of codes in use: exp of the entropy of their frequencies. codes (N, G) -> (G,)."""
    usage = F.one_hot(codes, n_c).to(torch.float64).mean(0)
    return torch.special.entr(usage).sum(-1).exp()


class Quantizer(nn.Module):
    """The codebook C: G groups of n_c embeddings e of size n_q. z_q is the sum of the chosen embeddings."""

    def __init__(self, settings: ACGDConfig) -> None:
        super().__init__()
        self.distance = settings.logits == "distance"
        scale = 1.0 if self.distance else settings.groups**-0.5
        self.codes = nn.Parameter(torch.randn(settings.groups, settings.codes, settings.width) * scale)

    @property
    def encoding_size(self) -> int:
        """Number of values of z_e per group: n_c logits, or n_q coordinates where distances give the logits."""
        return self.codes.shape[2] if self.distance else self.codes.shape[1]

    def logits(self, z_e: Tensor) -> Tensor:
        """z_e (B, G, n_c or n_q) -> logits (B, G, n_c)."""
        return logits_by_distance(z_e, self.codes) if self.distance else z_e

    def embed(self, onehot: Tensor) -> Tensor:
        """onehot (B, G, n_c) -> z_q (B, n_q), the sum of the chosen embeddings."""
        return onehot.flatten(1) @ self.codes.flatten(0, 1)
