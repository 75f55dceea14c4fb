"""Intervals of success over student seeds, and of the difference between two variants."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import binomtest, norm, t

SEEDS_FOR_A_CLAIM = 5
"""Least number of student seeds for a claim. With fewer seeds a report shows the interval of a difference only.

The t interval is 4.3 standard errors wide on each side for three seeds, and 2.8 for five. benchmarks/verdict.py
measures the power of both.
"""


@dataclass(frozen=True)
class Interval:
    """A mean and the interval around it, as fractions."""

    mean: float
    low: float
    high: float


@dataclass(frozen=True)
class Difference:
    """Success of the first variant minus success of the second, on the same episodes."""

    mean: float
    low: float
    high: float
    wins: int
    """Episodes that only the first variant solved."""
    losses: int
    """Episodes that only the second variant solved."""
    episodes: int
    """Pairs compared, over all student seeds."""
    p_value: float
    """Exact McNemar test of wins against losses.

    The test assumes that episodes are independent given these students. Unlike the interval, it does not cover students
    of other seeds.
    """


def over_seeds(rates: Sequence[float], least: float = 0.0, confidence: float = 0.95) -> Interval:
    """Student's t interval of a mean over student seeds, clipped to [0, 1]. For one seed the interval is [0, 1].

    least: least half width, that of the noise of the episodes (`episode_noise`). Raises ValueError without a seed.
    """
    values = np.asarray(rates, dtype=np.float64)
    if values.size == 0:
        raise ValueError("there is no student seed: give at least one rate")
    mean = float(values.mean())
    if values.size == 1:
        return Interval(mean, 0.0, 1.0)
    half = float(t.ppf(0.5 + confidence / 2, values.size - 1) * values.std(ddof=1) / np.sqrt(values.size))
    half = max(half, least)
    return Interval(mean, max(0.0, mean - half), min(1.0, mean + half))


def episode_noise(successes: Sequence[int], episodes: Sequence[int], confidence: float = 0.95) -> float:
    """Half width of the interval of the mean success rate over tasks, from the noise of the episodes only.

    successes, episodes: one count per task. The interval of Agresti and Coull adds two successes and two failures to
    each task, so that the width is never zero.
    """
    n = np.asarray(episodes, dtype=np.float64) + 4
    rate = (np.asarray(successes, dtype=np.float64) + 2) / n
    return float(norm.ppf(0.5 + confidence / 2) * np.sqrt((rate * (1 - rate) / n).sum()) / len(n))


def mcnemar(wins: int, losses: int) -> float:
    """Two-sided exact p-value of the hypothesis that wins and losses are equally likely; 1 without wins and losses."""
    return 1.0 if wins + losses == 0 else float(binomtest(wins, wins + losses, 0.5).pvalue)


def paired_difference(
    first: Sequence[np.ndarray], second: Sequence[np.ndarray], confidence: float = 0.95
) -> Difference:
    """Mean over tasks of the difference in success, with an interval over student seeds and starts.

    first, second: one bool array (S, E) per task, student seeds by episodes. Row i has the same student seed in both,
    column j the same episode seed. With one student seed the interval covers the episodes only. Raises ValueError of
    arrays that do not pair.
    """
    differences = []
    for a, b in zip(first, second, strict=True):
        if np.shape(a) != np.shape(b) or np.ndim(a) != 2 or np.size(a) == 0:
            raise ValueError(
                f"outcomes have shapes {np.shape(a)} and {np.shape(b)}: "
                "give (student seeds, episodes), the same for both variants"
            )
        differences.append(np.asarray(a, dtype=np.int64) - np.asarray(b, dtype=np.int64))
    if len({d.shape[0] for d in differences}) != 1:
        raise ValueError("the tasks have different student seeds: give at least one task, and the same seeds for all")
    wins, losses = (int(sum((d == sign).sum() for d in differences)) for sign in (1, -1))
    mean, half = float(np.mean([d.mean() for d in differences])), float(half_width(differences, confidence))
    return Difference(
        mean,
        max(-1.0, mean - half),
        min(1.0, mean + half),
        wins,
        losses,
        sum(d.size for d in differences),
        mcnemar(wins, losses),
    )


def half_width(differences: Sequence[np.ndarray], confidence: float = 0.95) -> np.ndarray:
    """Half width (...) of the interval of the mean over tasks. differences: one array (..., S, E) of -1, 0, 1 per task.

    Students and starts are crossed random factors. The variance over students is that of their means over all tasks. It
    contains the noise of the episodes. The variance over starts is added without that noise. Each variance is
    multiplied by the squared quantile of Student's t with its degrees of freedom. The floor is the variance of S E
    independent pairs per task, with half a count added to wins and to losses (Agresti and Min 2005), so that the width
    is never zero.
    """
    tasks, (students, _) = len(differences), differences[0].shape[-2:]
    by_student = np.mean([d.mean(axis=-1) for d in differences], axis=0)  # (..., S)
    student_variance = by_student.var(axis=-1, ddof=1) / students if students > 1 else np.zeros(by_student.shape[:-1])
    start_variance, floor = 0.0, 0.0
    for d in differences:
        start_variance = start_variance + _start_variance(d)
        floor = floor + _floor(d)
    tail, starts = 0.5 + confidence / 2, min(d.shape[-1] for d in differences)
    spread = _quantile(tail, students) ** 2 * student_variance
    spread = spread + _quantile(tail, starts) ** 2 * np.maximum(start_variance, 0) / tasks**2
    return np.sqrt(np.maximum(spread, norm.ppf(tail) ** 2 * floor / tasks**2))


def _start_variance(d: np.ndarray) -> np.ndarray:
    """Variance (...) of a task's mean difference over starts, minus the noise of the episodes. d: (..., S, E).

    The noise is estimated from two students or more; with one student it is not subtracted. The result can be negative
    by chance. It is 0 for one start.
    """
    students, starts = d.shape[-2:]
    if starts == 1:
        return np.zeros(d.shape[:-2])
    by_start = d.mean(axis=-2, dtype=np.float64)  # (..., E)
    variance = by_start.var(axis=-1, ddof=1) / starts
    if students == 1:
        return variance
    by_student = d.mean(axis=-1, dtype=np.float64)  # (..., S)
    mean = by_student.mean(axis=-1)
    squares = np.square(d, dtype=np.float64).sum(axis=(-2, -1)) + students * starts * mean**2
    squares -= starts * np.square(by_student).sum(axis=-1) + students * np.square(by_start).sum(axis=-1)
    noise = squares / ((students - 1) * (starts - 1))
    return variance - noise / (students * starts)


def _floor(d: np.ndarray) -> np.ndarray:
    """Variance (...) of a task's mean difference if all pairs were independent. d: (..., S, E). It is never zero."""
    pairs = d.shape[-2] * d.shape[-1] + 2
    wins, losses = ((d == sign).sum(axis=(-2, -1)) + 0.5 for sign in (1, -1))
    return (wins + losses - (wins - losses) ** 2 / pairs) / pairs**2


def _quantile(tail: float, count: int) -> float:
    """Quantile of Student's t for a variance over `count` values. With one value the result is not used."""
    return float(t.ppf(tail, max(count - 1, 1)))
