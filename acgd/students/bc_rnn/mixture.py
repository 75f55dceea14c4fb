"""Heads of the recurrent student: what a hidden state says of the action, and the error of that."""

import math
from typing import NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from acgd.nn.excitation import ActionSpace, to_loss_space


class Mixture(NamedTuple):
    """Gaussians over an action, each with a diagonal covariance. The leading dimensions are free."""

    means: Tensor
    """(..., M, A), strictly inside the box."""
    stds: Tensor
    """(..., M, A)."""
    logits: Tensor
    """(..., M), of the modes."""

    def log_likelihood(self, action: Tensor, space: ActionSpace = "raw") -> Tensor:
        """log sum_m w_m N(a; mu_m, sigma_m), with a and mu_m compared in `space`. (..., A) -> (...)."""
        z = (to_loss_space(action, space)[..., None, :] - to_loss_space(self.means, space)) / self.stds
        each = (-0.5 * z.square() - self.stds.log() - 0.5 * math.log(2 * math.pi)).sum(-1)
        return (self.logits.log_softmax(-1) + each).logsumexp(-1)

    def likeliest(self) -> Tensor:
        """The mean of the mode of largest weight, (..., A).

        Backward, the mode is a softmax over all modes (straight-through), so that a gradient of Q reaches the weights:
        it favours modes whose actions are better.
        """
        mode = self.logits.argmax(-1)
        chosen = torch.take_along_dim(self.means, mode[..., None, None], dim=-2).squeeze(-2)
        weights = self.logits.softmax(-1)
        return chosen + ((weights - weights.detach())[..., None] * self.means.detach()).sum(-2)


class MixtureHead(nn.Module):
    """Hidden state -> Mixture. Means pass a tanh, standard deviations are softplus + `least_std`."""

    def __init__(self, width: int, actions: int, modes: int, least_std: float) -> None:
        super().__init__()
        self.means = nn.Linear(width, modes * actions)
        self.stds = nn.Linear(width, modes * actions)
        self.logits = nn.Linear(width, modes)
        self.modes, self.least_std = modes, least_std

    def forward(self, hidden: Tensor) -> Mixture:
        """(..., width) -> Mixture, in full precision: a likelihood needs more digits than bfloat16 has."""
        means, stds = (layer(hidden).float().unflatten(-1, (self.modes, -1)) for layer in (self.means, self.stds))
        return Mixture(means.tanh(), F.softplus(stds) + self.least_std, self.logits(hidden).float())
