"""Errors of chunks of actions, each a value per window (B,), to be averaged by the caller."""

from torch import Tensor


def over_valid_steps(values: Tensor, mask: Tensor, weights: Tensor | None = None) -> Tensor:
    """Weighted mean over the steps inside the episode. values (B, k), mask (B, k) bool, weights (k,) -> (B,)."""
    share = mask.to(values.dtype) if weights is None else mask * weights
    return (share * values).sum(-1) / share.sum(-1)


def l1(chunk: Tensor, target: Tensor, mask: Tensor) -> Tensor:
    """Mean over valid steps of the 1-norm of the error. (B, k, A), (B, k, A), (B, k) bool -> (B,)."""
    return over_valid_steps((chunk - target).abs().sum(-1), mask)
