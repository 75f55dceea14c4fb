"""The losses of Sections III-A to III-C, each a value per window (B,), to be averaged by the caller.

Norms are sums over components, as in the paper, and means over the chunk's valid steps, so that their balance does not
change with the length of the chunk.
"""

import math

import torch
from torch import Tensor
from torch.nn import functional as F


def over_valid_steps(values: Tensor, mask: Tensor, weights: Tensor | None = None) -> Tensor:
    """Weighted mean over the steps inside the episode. values (B, k), mask (B, k) bool, weights (k,) -> (B,)."""
    share = mask.to(values.dtype) if weights is None else mask * weights
    return (share * values).sum(-1) / share.sum(-1)


def act(decoded: Tensor, actions: Tensor, mask: Tensor) -> Tensor:
    """L_act = 1/k sum_i |a_hat_i - a_i|_1 over valid steps. (B, k, A), (B, k, A), (B, k) -> (B,)."""
    return over_valid_steps((decoded - actions).abs().sum(-1), mask)


def code(logits: Tensor, onehot: Tensor) -> Tensor:
    """L_code = |sigma(z_e) - SG[onehot]|_1, mean over groups. (B, G, n_c), (B, G, n_c) -> (B,).

    The stop gradient must be on the one-hot alone: with the straight-through one-hot, or with both of the paper's terms
    stopped, the gradient is exactly zero.
    """
    return (logits.softmax(-1) - onehot.detach()).abs().sum(-1).mean(-1)


def usage(logits: Tensor) -> Tensor:
    """How far the batch's mean code usage is from uniform, in nats: log n_c - H(mean sigma(z_e)), mean over groups -> ().

    Not in the paper, where nothing keeps the codes in use.
    """
    mean = logits.softmax(-1).mean(0)
    return math.log(logits.shape[-1]) - torch.special.entr(mean).sum(-1).mean()


def lat(logits: Tensor, codes: Tensor) -> Tensor:
    """L_lat = CE(phi_act's code, phi_lat's logits), mean over groups. (B, G, n_c), (B, G) -> (B,)."""
    return F.cross_entropy(logits.flatten(0, 1), codes.flatten(), reduction="none").view(codes.shape).mean(-1)


def distill(gain: Tensor, mask: Tensor, weights: Tensor) -> Tensor:
    """L_distill = - sum_j m_j w_j (Q_i(s_{t+j}, a_hat_{t+j}) - Q_i(s_{t+j}, a_{t+j})) / spread_i, as a weighted mean over valid steps.

    gain (B, k) in spreads of the row's task, mask (B, k), weights (k,) -> (B,). The paper's has no Q of the demonstrated
    action a, a constant.
    """
    return -over_valid_steps(gain, mask, weights)


def step_weights(guided_steps: str, k: int, device: torch.device) -> Tensor:
    """w_j of L_distill: every step of the chunk, or the first alone -> (k,)."""
    if guided_steps == "chunk":
        return torch.ones(k, device=device)
    return F.one_hot(torch.tensor(0, device=device), k).float()
