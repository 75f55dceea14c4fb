"""False positives and power of the report's interval in simulated studies: `python -m benchmarks.verdict`.

Without a true difference a 95% interval may exclude zero in 5% of studies. Both variants have the same base rate. Each
student's success probability varies around it, independently in both variants. Either all starts are alike, or half of
them determine the outcome. The table compares the report's interval with Student's t over seeds and with a percentile
bootstrap over seeds and starts, and lists the power at a true difference.
"""

from collections.abc import Callable, Iterator
from itertools import product
from typing import NamedTuple

import numpy as np
from scipy.stats import t

from acgd.evaluation.intervals import half_width
from benchmarks.row import Row

LEVEL = 0.06
"""Largest accepted share of studies without a true difference whose interval excludes zero."""
STUDIES, AT_ONCE = 4000, 500
BASES = (0.1, 0.5, 0.9, 0.97)

Excludes = Callable[[np.ndarray], np.ndarray]
"""Differences (n, T, S, E) in {-1, 0, 1} -> (n,) bool, whether the interval of the mean excludes zero.

n studies, T tasks, S student seeds, E episodes."""


class Cell(NamedTuple):
    """Design of a study, and the true success probabilities of its students."""

    students: int
    spread: float
    """Standard deviation of success probabilities over students, before the clip to [0, 1]."""
    base: float
    episodes: int
    tasks: int
    by_start: float = 0.0
    """Share of the starts that determine the outcome, independently in both variants."""
    gain: float = 0.0
    """True difference of the two variants."""


CELLS = tuple(Cell(*design) for design in product((3, 5, 10), (0, 0.05, 0.14), BASES, (25, 100), (1, 5)))


def studies(cell: Cell, count: int, rng: np.random.Generator) -> np.ndarray:
    """Simulated differences in success (n, T, S, E) in {-1, 0, 1}."""
    shape = (count, cell.tasks, cell.students, cell.episodes)
    outcomes = []
    for sign in (1, -1):
        base = cell.base + sign * cell.gain / 2
        skill = np.clip(base + cell.spread * rng.normal(size=(count, 1, cell.students, 1)), 0, 1)
        solved = rng.random(shape, dtype=np.float32) < skill
        if cell.by_start:
            starts = (count, cell.tasks, 1, cell.episodes)
            solved = np.where(rng.random(starts) < cell.by_start, rng.random(starts) < base, solved)
        outcomes.append(solved.astype(np.int8))
    return outcomes[0] - outcomes[1]


def report(d: np.ndarray) -> np.ndarray:
    """Whether the report's interval excludes zero."""
    return np.abs(d.mean(axis=(1, 2, 3))) > half_width(list(np.moveaxis(d, 1, 0))) + 1e-12


def student_t(d: np.ndarray) -> np.ndarray:
    """Student's t over the differences per seed. The interval has no width where all seeds agree."""
    by_seed, students = d.mean(axis=(1, 3)), d.shape[2]
    half = t.ppf(0.975, students - 1) * by_seed.std(axis=1, ddof=1) / np.sqrt(students)
    return np.abs(by_seed.mean(axis=1)) > half + 1e-12


def bootstrap(d: np.ndarray, resamples: int = 400) -> np.ndarray:
    """Percentile bootstrap. It resamples student seeds jointly for all tasks, and starts within each task."""
    rng = np.random.default_rng(0)
    count, tasks, students, episodes = d.shape
    seeds = rng.multinomial(students, np.full(students, 1 / students), size=resamples) / students
    means = np.zeros((count, resamples), dtype=np.float32)
    for task in range(tasks):
        starts = rng.multinomial(episodes, np.full(episodes, 1 / episodes), size=resamples) / episodes
        by_start = np.tensordot(d[:, task].astype(np.float32), starts.astype(np.float32), axes=(2, 1))  # (n, S, R)
        means += np.einsum("rs,nsr->nr", seeds.astype(np.float32), by_start)
    low, high = np.quantile(means / tasks, [0.025, 0.975], axis=1)
    return (low > 1e-6) | (high < -1e-6)


def rate(cell: Cell, excludes: Excludes, count: int = STUDIES, seed: int = 0) -> float:
    """Share of studies whose interval excludes zero."""
    return float(np.mean(np.concatenate([excludes(d) for d in _batches(cell, count, seed)])))


def _batches(cell: Cell, count: int, seed: int) -> Iterator[np.ndarray]:
    rng = np.random.default_rng(seed)
    for start in range(0, count, AT_ONCE):
        yield studies(cell, min(AT_ONCE, count - start), rng)


def run() -> list[Row]:
    """Rows per number of student seeds and spread: worst rate over the other parameters, and power."""
    rows = []
    for students, spread in product((3, 5, 10), (0, 0.05, 0.14)):
        cells = [cell for cell in CELLS if (cell.students, cell.spread) == (students, spread)]
        name = f"verdict/{students} seeds, spread {spread:g}"
        by_start = max(rate(cell._replace(by_start=0.5), report) for cell in cells)
        old = max(rate(cell, bootstrap, 500) for cell in cells if cell.tasks == 1)
        gained = Cell(students, spread, 0.8, 25, 3, gain=0.1)
        rows += [
            _level(f"{name}: false positives", max(rate(cell, report) for cell in cells), f"<= {LEVEL:.0%}", LEVEL),
            _level(f"{name}: half of the starts decide", by_start, f"<= {LEVEL:.0%}", LEVEL),
            _level(f"{name}: Student's t alone", max(rate(cell, student_t, 1000) for cell in cells)),
            _level(f"{name}: percentile bootstrap", old),
            _level(f"{name}: power, 0.1 at 0.8, 3 tasks x 25 episodes", rate(gained, report, 1000)),
        ]
    return rows


def _level(name: str, value: float, target: str = "", most: float | None = None) -> Row:
    met = None if most is None else value <= most
    return Row(name=name, value=value, unit="of studies", ratio=None, target=target, met=met)


if __name__ == "__main__":
    from benchmarks.table import table

    print(table([dict(row) for row in run()]))
