"""Temporal ensembling of overlapping chunks (Section III-A), in the paper's order and in ACT's."""

import numpy as np


def weights(ages: np.ndarray, oldest: np.ndarray, mode: str, eta: float) -> np.ndarray:
    """w_i = exp(-eta i), normalised: i counts from the newest prediction in the paper, from the oldest in ACT.

    ages (k,) steps since each prediction was made; oldest (n,) age of each row's oldest one -> (n, k), zero beyond it.
    """
    made = ages <= oldest[:, None]
    order = np.broadcast_to(ages, made.shape) if mode == "ensemble-paper" else oldest[:, None] - ages
    w = np.where(made, np.exp(-eta * np.where(made, order, 0)), 0.0)
    return w / w.sum(-1, keepdims=True)


def ensemble(predictions: np.ndarray, oldest: np.ndarray, mode: str, eta: float) -> np.ndarray:
    """predictions (n, k, A) for the current step, newest first; oldest (n,) as above -> (n, A)."""
    w = weights(np.arange(predictions.shape[1]), oldest, mode, eta)
    return np.einsum("nk,nka->na", w, predictions).astype(np.float32)
