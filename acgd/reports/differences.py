"""Differences of success between variants, and between a student with and without its image, on the same starts."""

from collections.abc import Sequence

import numpy as np
import pandas as pd

from acgd.evaluation.intervals import Difference, paired_difference
from acgd.reports.success import RULES

ALL_TASKS = "all tasks"
VISUAL_DROP = 0.2
"""Least loss of success without the image at which a task counts as visual."""

_COLUMNS = ["mean", "low", "high", "wins", "losses", "pairs", "p_value", "seeds", "by_seed"]


def paired(episodes: pd.DataFrame, baseline: str, tasks: Sequence[str]) -> pd.DataFrame:
    """paired.csv: variant minus baseline, per task and over all tasks, for each success rule.

    Pairs have the same student seed, start and episode seed. A variant without a pair has no row.
    """
    students = episodes[episodes["kind"] == "student"]
    others = [variant for variant in dict.fromkeys(students["variant"]) if variant != baseline]
    rows = []
    for variant in others:
        for rule in RULES:
            for task, *figures in _compare(students, variant, baseline, rule, tasks):
                rows.append((variant, baseline, task, rule, *figures))
    return pd.DataFrame(rows, columns=["variant", "baseline", "task", "rule", *_COLUMNS])


def without_image(episodes: pd.DataFrame, rule: str, tasks: Sequence[str]) -> pd.DataFrame:
    """Success with the episode's images minus success with another episode's, per variant and task.

    Columns: variant, task, own, shuffled (the two rates), and those of `paired`. mean is the difference of the rates.
    """
    rows = []
    shuffled = episodes[(episodes["kind"] == "control") & (episodes["image_features"] == "shuffled")]
    for variant, without in shuffled.groupby("parent", sort=False):
        own = episodes[(episodes["kind"] == "student") & (episodes["variant"] == variant)]
        both = pd.concat([own, without])
        for task, *figures in _compare(both, variant, without["variant"].iloc[0], rule, tasks):
            rates = [part[part["task"] == task][rule].mean() for part in (own, without)]
            rows.append((variant, task, *rates, *figures))
    rows = [row for row in rows if row[1] != ALL_TASKS]
    return pd.DataFrame(rows, columns=["variant", "task", "own", "shuffled", *_COLUMNS])


def _compare(episodes: pd.DataFrame, first: str, second: str, rule: str, tasks: Sequence[str]) -> list[tuple]:
    """(task, figures...) of first minus second, for each common task, and for all of them if there are several."""
    by_task = {}
    for task in tasks:
        a, b = (
            _grid(episodes[(episodes["variant"] == name) & (episodes["task"] == task)], rule)
            for name in (first, second)
        )
        seeds, starts = a.index.intersection(b.index), a.columns.intersection(b.columns)
        if len(seeds) and len(starts):
            by_task[task] = a.loc[seeds, starts], b.loc[seeds, starts]
    groups = {task: [task] for task in by_task}
    if len(by_task) > 1 and len({tuple(a.index) for a, _ in by_task.values()}) == 1:
        groups[ALL_TASKS] = list(by_task)
    rows = []
    for name, members in groups.items():
        pairs = [by_task[task] for task in members]
        difference = paired_difference([a.to_numpy() for a, _ in pairs], [b.to_numpy() for _, b in pairs])
        by_seed = np.mean([(a.astype(float) - b.astype(float)).mean(axis=1).to_numpy() for a, b in pairs], axis=0)
        rows.append((name, *_figures(difference, by_seed)))
    return rows


def _grid(episodes: pd.DataFrame, rule: str) -> pd.DataFrame:
    """(student seeds, starts) bool. An episode that one student of the variant lacks is left out for all students."""
    grid = episodes.pivot_table(index="seed", columns=["start", "episode"], values=rule, aggfunc="first", sort=True)
    return grid.dropna(axis=1).astype(bool)


def _figures(difference: Difference, by_seed: np.ndarray) -> tuple:
    d = difference
    return (
        d.mean,
        d.low,
        d.high,
        d.wins,
        d.losses,
        d.episodes,
        d.p_value,
        len(by_seed),
        " ".join(f"{value:+.4f}" for value in by_seed),
    )
