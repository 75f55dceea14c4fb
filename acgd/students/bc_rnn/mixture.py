"""The mixture of Gaussians over an action, and the head of the recurrent student that computes it."""

import math
from typing import NamedTuple

from torch import Tensor, nn
from torch.nn import functional as F

from acgd.nn.excitation import ActionSpace, to_loss_space


class Mixture(NamedTuple):
    """Gaussians over an action, each with a diagonal covariance. The leading dimensions are free."""

    means: Tensor
    """(..., M, A) in (-1, 1)."""
    stds: Tensor
    """(..., M, A)."""
    logits: Tensor
    """(..., M), logits of the weights of the modes."""

    def log_likelihood(self, action: Tensor, space: ActionSpace = "raw") -> Tensor:
        """log sum_m w_m N(a; mu_m, sigma_m) of an action (..., A), with a and mu_m in `space` -> (...)."""
        z = (to_loss_space(action, space)[..., None, :] - to_loss_space(self.means, space)) / self.stds
        each = (-0.5 * z.square() - self.stds.log() - 0.5 * math.log(2 * math.pi)).sum(-1)
        return (self.logits.log_softmax(-1) + each).logsumexp(-1)

    def likeliest(self) -> Tensor:
        """The mean (..., A) of the mode with the largest weight.

        The gradient is that of the mean under the softmax weights (straight-through). A gradient of Q thus reaches the
        weights, and favours the modes with better actions.
        """
        mode = self.logits.argmax(-1)
        chosen = self.means.gather(-2, mode[..., None, None].expand_as(self.means[..., :1, :])).squeeze(-2)
        weights = self.logits.softmax(-1)
        return chosen + ((weights - weights.detach())[..., None] * self.means.detach()).sum(-2)


class MixtureHead(nn.Module):
    """Hidden state -> Mixture. Means end in a tanh. Standard deviations are softplus + `least_std`."""

    def __init__(self, width: int, actions: int, modes: int, least_std: float) -> None:
        super().__init__()
        self.means = nn.Linear(width, modes * actions)
        self.stds = nn.Linear(width, modes * actions)
        self.logits = nn.Linear(width, modes)
        self.modes, self.least_std = modes, least_std

    def forward(self, hidden: Tensor) -> Mixture:
        """(..., width) -> Mixture in float32, since a likelihood needs more digits than bfloat16 has."""
        means, stds = (layer(hidden).float().unflatten(-1, (self.modes, -1)) for layer in (self.means, self.stds))
        return Mixture(means.tanh(), F.softplus(stds) + self.least_std, self.logits(hidden).float())
