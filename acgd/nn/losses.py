"""Errors of action chunks, one value per window (B,). The caller averages them."""

from torch import Tensor


def over_valid_steps(values: Tensor, mask: Tensor, weights: Tensor | None = None) -> Tensor:
    """Weighted mean over the valid steps. values (B, k), mask (B, k) bool, weights (k,) or None -> (B,)."""
    share = mask.to(values.dtype) if weights is None else mask * weights
    return (share * values).sum(-1) / share.sum(-1)


def l1(chunk: Tensor, target: Tensor, mask: Tensor) -> Tensor:
    """Mean over valid steps of |chunk - target|_1. chunk, target (B, k, A), mask (B, k) bool -> (B,)."""
    return over_valid_steps((chunk - target).abs().sum(-1), mask)
