"""Rank correlation over actions of one state. This file imports no torch, because the report imports it."""

import numpy as np
from scipy import stats


def rank_correlations(q: np.ndarray, returns: np.ndarray) -> np.ndarray:
    """Spearman's correlation over the K candidates of each of V states.

    q, returns: (V, K) -> (V,), nan where all values of a state are equal.
    """
    ranks = [stats.rankdata(values, axis=1) for values in (q, returns)]
    x, y = (r - r.mean(1, keepdims=True) for r in ranks)
    norm = np.sqrt((x**2).sum(1) * (y**2).sum(1))
    return np.divide((x * y).sum(1), norm, out=np.full(len(q), np.nan), where=norm > 0)
