"""The order of actions within one state, by one critic and by the simulator. Light: a report imports it, too."""

import numpy as np
from scipy import stats


def rank_correlations(q: np.ndarray, returns: np.ndarray) -> np.ndarray:
    """Spearman's correlation over the candidates of each state, (V, K), (V, K) -> (V,); nan where all returns are
    equal."""
    ranks = [stats.rankdata(values, axis=1) for values in (q, returns)]
    x, y = (r - r.mean(1, keepdims=True) for r in ranks)
    norm = np.sqrt((x**2).sum(1) * (y**2).sum(1))
    return np.divide((x * y).sum(1), norm, out=np.full(len(q), np.nan), where=norm > 0)
