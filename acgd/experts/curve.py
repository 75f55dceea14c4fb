"""The learning curve of an expert: success on validation seeds while it trains."""

import csv
from pathlib import Path

import numpy as np

from acgd.experts.policy import Expert
from acgd.experts.settings import ExpertRequest
from acgd.experts.success import ENVIRONMENTS, episodes
from acgd.nn.q_ensemble import Critic
from acgd.simulate.lockstep import Lockstep
from acgd.simulate.seeds import SEEDS


class Curve:
    """Points of the learning curve. The best expert so far, by (final success, return), is kept in `state`/best."""

    def __init__(self, config: ExpertRequest, state: Path, metrics, points: list[dict]) -> None:
        self.points = points
        self._config, self._best, self._metrics = config, state / "best", metrics
        self._lock = Lockstep(config.task, ENVIRONMENTS, image_size=None, reward_weights=config.expert.reward_weights)

    def add(self, expert: Expert, step: int, critic: Critic | None = None, **extra: float) -> dict:
        """Evaluates the deterministic `expert` on validation seeds, and returns the new point.

        Validation seeds are disjoint from the card's seeds. The best expert is saved, with `critic` if there is one.
        extra: further entries of the point.
        """
        count = self._config.expert.evaluation_episodes
        rows = episodes(expert, self._config.task, SEEDS.validation.take(count), self._lock)
        mean = {key: float(np.mean([row[key] for row in rows])) for key in ("final", "held", "once", "return", "steps")}
        length = mean.pop("steps")
        point = {"step": step, **mean, "length": length, **extra}
        self.points.append(point)
        self._metrics.log(step, **{key: value for key, value in point.items() if key != "step"})
        if point == max(self.points, key=lambda row: (row["final"], row["return"])):
            self._best.mkdir(parents=True, exist_ok=True)
            expert.meta["steps"] = step
            expert.save(self._best)
            if critic:
                critic.save(self._best)
        return point


def write_curve(points: list[dict], path: Path) -> None:
    """Writes the learning curve as csv."""
    with open(path, "w", newline="") as file:
        writer = csv.DictWriter(file, list(points[0]), lineterminator="\n")
        writer.writeheader()
        writer.writerows(points)
