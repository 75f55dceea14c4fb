"""The losses of codebook and imitation (Sections III-A, III-C): one value per window (B,). The caller averages them.

A norm is a sum over components, as in the paper, and a mean over the chunk's valid steps. The mean makes the balance of
the losses independent of the chunk's length.
"""

import math

import torch
from torch import Tensor
from torch.nn import functional as F

from acgd.nn.losses import l1


def act(decoded: Tensor, actions: Tensor, mask: Tensor) -> Tensor:
    """L_act = 1/k sum_i |a_hat_i - a_i|_1 over valid steps. (B, k, A), (B, k, A), (B, k) -> (B,)."""
    return l1(decoded, actions, mask)


def code(logits: Tensor, onehot: Tensor) -> Tensor:
    """L_code = |sigma(z_e) - SG[onehot]|_1, mean over groups. (B, G, n_c), (B, G, n_c) -> (B,).

    Only the one-hot may have the stop gradient. With the straight-through one-hot, or with a stop gradient on both of
    the paper's terms, the gradient is exactly zero.
    """
    return (logits.softmax(-1) - onehot.detach()).abs().sum(-1).mean(-1)


def usage(logits: Tensor) -> Tensor:
    """Distance of the mean code usage from uniform, in nats: log n_c - H(mean sigma(z_e)), mean over groups -> ().

    The paper has no term that keeps the codes in use (docs/deviations.md).
    """
    mean = logits.softmax(-1).mean(0)
    return math.log(logits.shape[-1]) - torch.special.entr(mean).sum(-1).mean()


def lat(logits: Tensor, codes: Tensor) -> Tensor:
    """L_lat = CE(phi_act's code, phi_lat's logits), mean over groups. (B, G, n_c), (B, G) -> (B,)."""
    return F.cross_entropy(logits.flatten(0, 1), codes.flatten(), reduction="none").view(codes.shape).mean(-1)
