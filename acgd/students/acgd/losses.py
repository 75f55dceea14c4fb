"""The losses of codebook and imitation (Sections III-A, III-C), a value per window (B,), to be averaged by the caller.

Norms are sums over components, as in the paper, and means over the chunk's valid steps, so that their balance does not
change with the length of the chunk.
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

    The stop gradient must be on the one-hot alone: with the straight-through one-hot, or with both of the paper's terms
    stopped, the gradient is exactly zero.
    """
    return (logits.softmax(-1) - onehot.detach()).abs().sum(-1).mean(-1)


def usage(logits: Tensor) -> Tensor:
    """Distance of the mean code usage from uniform, in nats: log n_c - H(mean sigma(z_e)), mean over groups -> ().

    Not in the paper, where nothing keeps the codes in use.
    """
    mean = logits.softmax(-1).mean(0)
    return math.log(logits.shape[-1]) - torch.special.entr(mean).sum(-1).mean()


def lat(logits: Tensor, codes: Tensor) -> Tensor:
    """L_lat = CE(phi_act's code, phi_lat's logits), mean over groups. (B, G, n_c), (B, G) -> (B,)."""
    return F.cross_entropy(logits.flatten(0, 1), codes.flatten(), reduction="none").view(codes.shape).mean(-1)
