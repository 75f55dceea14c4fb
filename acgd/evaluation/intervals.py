"""How sure a success rate, or a difference of two, is: pure functions of arrays of outcomes."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import binomtest, norm, t


@dataclass(frozen=True)
class Interval:
    """A mean and the interval around it, as fractions."""

    mean: float
    low: float
    high: float


@dataclass(frozen=True)
class Difference:
    """Success of the first variant minus that of the second, on the same episodes."""

    mean: float
    low: float
    high: float
    wins: int
    """Episodes that only the first variant solved."""
    losses: int
    """Episodes that only the second solved."""
    episodes: int
    """Pairs compared, over all student seeds."""
    p_value: float
    """Exact McNemar test of wins against losses. It takes episodes as independent given these students, so it says
    nothing of students trained from other seeds; the interval does."""


def wilson(successes: int, episodes: int, confidence: float = 0.95) -> Interval:
    """Wilson's score interval of a success rate; inside [0, 1] and honest at 0 and at all successes."""
    if not 0 <= successes <= episodes or episodes < 1:
        raise ValueError(
            f"{successes} successes of {episodes} episodes: need 0 <= successes <= episodes and at least one episode"
        )
    z = float(norm.ppf(0.5 + confidence / 2))
    rate, shrink = successes / episodes, 1 + z * z / episodes
    centre = (rate + z * z / (2 * episodes)) / shrink
    half = z / shrink * np.sqrt(rate * (1 - rate) / episodes + z * z / (4 * episodes * episodes))
    return Interval(
        rate, 0.0 if successes == 0 else float(centre - half), 1.0 if successes == episodes else float(centre + half)
    )


def over_seeds(rates: Sequence[float], confidence: float = 0.95) -> Interval:
    """Student's t interval of a mean over training seeds, cut to [0, 1]; of one seed alone nothing is known: [0, 1].

    Rates that agree to the last digit give an interval of no width: read it beside the Wilson interval of the episodes.
    """
    values = np.asarray(rates, dtype=np.float64)
    if values.size == 0:
        raise ValueError("no training seed to average over")
    mean = float(values.mean())
    if values.size == 1:
        return Interval(mean, 0.0, 1.0)
    half = float(t.ppf(0.5 + confidence / 2, values.size - 1) * values.std(ddof=1) / np.sqrt(values.size))
    return Interval(mean, max(0.0, mean - half), min(1.0, mean + half))


def mcnemar(wins: int, losses: int) -> float:
    """Two-sided exact p-value that wins and losses are equally likely; 1 where the variants never differ."""
    return 1.0 if wins + losses == 0 else float(binomtest(wins, wins + losses, 0.5).pvalue)


def paired_difference(
    first: Sequence[np.ndarray],
    second: Sequence[np.ndarray],
    seed: int = 0,
    resamples: int = 5000,
    confidence: float = 0.95,
) -> Difference:
    """Mean over tasks of the difference in success, with a hierarchical bootstrap interval.

    first, second: one bool array (S, E) per task, student seeds by episodes, row i of both trained from the same seed and
    column j of both started from the same episode seed. Student seeds are resampled once for all tasks, since one student
    does all of them; episodes within each task, the same for all students, since all see the same starts. With one student
    seed the interval covers the episodes only.
    """
    differences = []
    for a, b in zip(first, second, strict=True):
        if np.shape(a) != np.shape(b) or np.ndim(a) != 2 or np.size(a) == 0:
            raise ValueError(
                f"outcomes of shapes {np.shape(a)} and {np.shape(b)}: need (student seeds, episodes), the same in both variants"
            )
        differences.append(np.asarray(a, dtype=np.int64) - np.asarray(b, dtype=np.int64))
    if len({d.shape[0] for d in differences}) != 1:
        raise ValueError("need at least one task, and the same student seeds in all of them")
    rng = np.random.default_rng(seed)
    students = _weights(differences[0].shape[0], resamples, rng)
    draws = np.zeros(resamples)
    for d in differences:
        draws += np.einsum("rs,se,re->r", students, d, _weights(d.shape[1], resamples, rng), optimize=True)
    tail = (1 - confidence) / 2
    low, high = np.quantile(draws / len(differences), [tail, 1 - tail])
    wins, losses = (int(sum((d == sign).sum() for d in differences)) for sign in (1, -1))
    mean = float(np.mean([d.mean() for d in differences]))
    return Difference(
        mean, float(low), float(high), wins, losses, sum(d.size for d in differences), mcnemar(wins, losses)
    )


def _weights(n: int, resamples: int, rng: np.random.Generator) -> np.ndarray:
    """(resamples, n): the share that each of n items has in a sample of n drawn with replacement."""
    return rng.multinomial(n, np.full(n, 1 / n), size=resamples) / n
