"""Success rates of episodes, with intervals."""

import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

import numpy as np

from acgd.evaluation.episodes import Episode, Label
from acgd.simulate.proportion import wilson

RULES = ("final", "held", "once")
"""Success rules: solved at the last step (the headline, as in the paper), for more than five steps, in any step."""


def success_rows(episodes: Sequence[Episode]) -> list[dict]:
    """One row per label and success rule, with the Wilson interval, in the order of the first episodes."""
    groups: dict[Label, list[Episode]] = {}
    for episode in episodes:
        groups.setdefault(episode.label, []).append(episode)
    rows = []
    for label, group in groups.items():
        means = {
            "mean_return": float(np.mean([episode.reward for episode in group])),
            "mean_steps": float(np.mean([episode.steps for episode in group])),
        }
        for rule in RULES:
            successes = sum(getattr(episode, rule) for episode in group)
            rate = wilson(successes, len(group))
            counts = {"rule": rule, "episodes": len(group), "successes": successes}
            rows.append(asdict(label) | counts | {"rate": rate.rate, "low": rate.low, "high": rate.high} | means)
    return rows


def write_summary(path: Path, episodes: Sequence[Episode], **about) -> list[dict]:
    """Writes summary.json: the entries `about`, and the rows of `success_rows` as `success`. Returns the rows."""
    rows = success_rows(episodes)
    path.write_text(json.dumps(about | {"success": rows}, indent=1) + "\n", encoding="utf-8")
    return rows
