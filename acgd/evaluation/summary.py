"""Success rates with their intervals, from episodes; and two variants compared on the same ones."""

import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

import numpy as np

from acgd.evaluation.episodes import Episode, Label
from acgd.evaluation.intervals import Difference, paired_difference, wilson

RULES = ("final", "held", "once")
"""Solved at the last step (the headline, as in the paper), for more than five steps, in any step."""


def success_rows(episodes: Sequence[Episode]) -> list[dict]:
    """One row per kind of episode and success rule, with the Wilson interval; in the order of first appearance."""
    groups: dict[Label, list[Episode]] = {}
    for episode in episodes:
        groups.setdefault(episode.label, []).append(episode)
    rows = []
    for label, group in groups.items():
        for rule in RULES:
            successes = sum(getattr(e, rule) for e in group)
            interval = wilson(successes, len(group))
            counts = {"rule": rule, "episodes": len(group), "successes": successes}
            rates = {"rate": interval.mean, "low": interval.low, "high": interval.high}
            means = {"mean_return": float(np.mean([e.reward for e in group])), "mean_steps": float(np.mean([e.steps for e in group]))}
            rows.append(asdict(label) | counts | rates | means)
    return rows


def write_summary(path: Path, episodes: Sequence[Episode], **about) -> list[dict]:
    """summary.json: what was run, and `success`, the rows of `success_rows`. Returns the rows."""
    rows = success_rows(episodes)
    path.write_text(json.dumps(about | {"success": rows}, indent=1) + "\n", encoding="utf-8")
    return rows


def compare(first: Sequence[Sequence[Episode]], second: Sequence[Sequence[Episode]], rule: str = "final") -> dict[str, Difference]:
    """Success of `first` minus that of `second` per task, and under "all" its mean over tasks.

    Each is a list over student seeds, in the same order, of episodes under one condition. Both must have run the same seeds.
    """
    tasks = list(dict.fromkeys(e.label.task for e in first[0]))
    a, b = ([_outcomes(side, task, rule) for task in tasks] for side in (first, second))
    for task, (seeds, _), (others, _) in zip(tasks, a, b, strict=True):
        if seeds != others:
            raise ValueError(f"{task}: the two variants ran different episode seeds; evaluate both with the same episodes and split")
    compared = {task: paired_difference([x], [y]) for task, (_, x), (_, y) in zip(tasks, a, b, strict=True)}
    return compared | {"all": paired_difference([x for _, x in a], [y for _, y in b])}


def _outcomes(students: Sequence[Sequence[Episode]], task: str, rule: str) -> tuple[list[int], np.ndarray]:
    """The episode seeds of a task in ascending order, and outcomes (S, E) bool in that order."""
    by_seed = [{e.seed: getattr(e, rule) for e in episodes if e.label.task == task} for episodes in students]
    if any(sum(e.label.task == task for e in episodes) != len(found) for episodes, found in zip(students, by_seed, strict=True)):
        raise ValueError(f"{task}: a seed occurs twice; pick the episodes of one condition first")
    seeds = sorted(by_seed[0])
    if any(sorted(found) != seeds for found in by_seed):
        raise ValueError(f"{task}: student seeds were evaluated on different episode seeds")
    return seeds, np.array([[found[seed] for seed in seeds] for found in by_seed], bool)
