"""Temporal ensembling of overlapping chunks (Section III-A), with the weights of the paper or of ACT."""

import numpy as np


def weights(ages: np.ndarray, oldest: np.ndarray, mode: str, eta: float) -> np.ndarray:
    """w_i = exp(-eta i), normalised. i counts from the newest prediction in the paper, from the oldest in ACT.

    ages (k,): steps since each prediction. oldest (n,): age of each row's oldest prediction -> (n, k), zero for older
    ages. mode: ensemble-paper or ensemble-act.
    """
    exists = ages <= oldest[:, None]
    order = np.broadcast_to(ages, exists.shape) if mode == "ensemble-paper" else oldest[:, None] - ages
    w = np.where(exists, np.exp(-eta * np.where(exists, order, 0)), 0.0)
    return w / w.sum(-1, keepdims=True)


def ensemble(predictions: np.ndarray, oldest: np.ndarray, mode: str, eta: float) -> np.ndarray:
    """Weighted mean of predictions (n, k, A) for one step, newest first. oldest (n,): as in `weights` -> (n, A)."""
    w = weights(np.arange(predictions.shape[1]), oldest, mode, eta)
    return np.einsum("nk,nka->na", w, predictions).astype(np.float32)
