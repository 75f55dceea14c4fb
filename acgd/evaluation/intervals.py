"""Intervals for success over training seeds, and for the difference of two variants: pure functions of outcomes."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import binomtest, norm, t

SEEDS_FOR_A_CLAIM = 5
"""Student seeds below which a report shows the interval of a difference and makes no claim. Student's t of three seeds
takes 4.3 standard errors, of five 2.8 (benchmarks/verdict.py has the power of both)."""


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
    """Episodes that only the second variant solved."""
    episodes: int
    """Pairs compared, over all student seeds."""
    p_value: float
    """Exact McNemar test of wins against losses. It takes episodes as independent given these students, so it says
    nothing of students trained from other seeds; the interval does."""


def over_seeds(rates: Sequence[float], least: float = 0.0, confidence: float = 0.95) -> Interval:
    """Student's t interval of a mean over training seeds, cut to [0, 1]. One seed tells nothing of the next: [0, 1].

    least: half width that the interval has at least, which is that of the episodes (`episode_noise`).
    """
    values = np.asarray(rates, dtype=np.float64)
    if values.size == 0:
        raise ValueError("no training seed to average over")
    mean = float(values.mean())
    if values.size == 1:
        return Interval(mean, 0.0, 1.0)
    half = float(t.ppf(0.5 + confidence / 2, values.size - 1) * values.std(ddof=1) / np.sqrt(values.size))
    half = max(half, least)
    return Interval(mean, max(0.0, mean - half), min(1.0, mean + half))


def episode_noise(successes: Sequence[int], episodes: Sequence[int], confidence: float = 0.95) -> float:
    """Half width of the mean over tasks of success rates, from the noise of episodes alone. One count per task.

    Agresti and Coull's interval: two successes and two failures are added to each task, so that it is never zero.
    """
    n = np.asarray(episodes, dtype=np.float64) + 4
    rate = (np.asarray(successes, dtype=np.float64) + 2) / n
    return float(norm.ppf(0.5 + confidence / 2) * np.sqrt((rate * (1 - rate) / n).sum()) / len(n))


def mcnemar(wins: int, losses: int) -> float:
    """Two-sided exact p-value that wins and losses are equally likely; 1 where the variants never differ."""
    return 1.0 if wins + losses == 0 else float(binomtest(wins, wins + losses, 0.5).pvalue)


def paired_difference(
    first: Sequence[np.ndarray], second: Sequence[np.ndarray], confidence: float = 0.95
) -> Difference:
    """Mean over tasks of the difference in success, with an interval for other student seeds and other starts.

    first, second: one bool array (S, E) per task, student seeds by episodes. Row i of both has the same student seed,
    column j of both the same episode seed. With one student seed the interval covers the episodes only.
    """
    differences = []
    for a, b in zip(first, second, strict=True):
        if np.shape(a) != np.shape(b) or np.ndim(a) != 2 or np.size(a) == 0:
            raise ValueError(
                f"outcomes of shapes {np.shape(a)} and {np.shape(b)}: "
                "need (student seeds, episodes), the same in both variants"
            )
        differences.append(np.asarray(a, dtype=np.int64) - np.asarray(b, dtype=np.int64))
    if len({d.shape[0] for d in differences}) != 1:
        raise ValueError("need at least one task, and the same student seeds in all of them")
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
    """Half width of the interval of the mean over tasks. differences: one array (..., S, E) of -1, 0, 1 per task.

    Students and starts are crossed random factors. The variance over students, of their means over all tasks, holds the
    noise of episodes as well; the variance over starts adds what it has beyond that noise. Each takes the quantile of
    Student's t with its own degrees of freedom. A floor takes all S E pairs of a task as independent and adds half a
    count to wins and to losses (Agresti and Min 2005), so that the width is never zero.
    """
    tasks, (students, _) = len(differences), differences[0].shape[-2:]
    by_student = np.mean([d.mean(axis=-1) for d in differences], axis=0)  # (..., S)
    of_students = by_student.var(axis=-1, ddof=1) / students if students > 1 else np.zeros(by_student.shape[:-1])
    of_starts, floor = 0.0, 0.0
    for d in differences:
        of_starts = of_starts + _beyond_noise(d)
        floor = floor + _floor(d)
    tail, starts = 0.5 + confidence / 2, min(d.shape[-1] for d in differences)
    spread = _quantile(tail, students) ** 2 * of_students
    spread = spread + _quantile(tail, starts) ** 2 * np.maximum(of_starts, 0) / tasks**2
    return np.sqrt(np.maximum(spread, norm.ppf(tail) ** 2 * floor / tasks**2))


def _beyond_noise(d: np.ndarray) -> np.ndarray:
    """Variance (...) of a task's mean difference over starts, less the noise of episodes, which needs two students.

    d: (..., S, E). Negative by chance. One start tells nothing: 0.
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
    """Variance (...) of a task's mean difference if all of its pairs were independent; d: (..., S, E). Never zero."""
    pairs = d.shape[-2] * d.shape[-1] + 2
    wins, losses = ((d == sign).sum(axis=(-2, -1)) + 0.5 for sign in (1, -1))
    return (wins + losses - (wins - losses) ** 2 / pairs) / pairs**2


def _quantile(tail: float, count: int) -> float:
    """Of Student's t, for a variance over so many values; one value has no variance, and its quantile is not used."""
    return float(t.ppf(tail, max(count - 1, 1)))
