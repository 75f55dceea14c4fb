"""Episodes of an evaluation: running, saving after each batch, and reading.

The outcome of an episode depends on its seed, its policy and its row in the batch. It does not depend on the other
episodes or on their number: seeds are batched in order, `lockstep` per batch, and policies are padded to that many
rows. Exception: with `image_features: shuffled` it depends on the episode whose image the policy sees.
"""

import json
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from safetensors import safe_open
from safetensors.numpy import save_file

from acgd.simulate.lockstep import Lockstep
from acgd.simulate.policy import Policy
from acgd.simulate.record import Outcomes
from acgd.simulate.roll import Goals, roll
from acgd.simulate.seeds import SEEDS
from acgd.store.atomic import replace_file
from acgd.store.progress import Bar
from acgd.tasks import registry
from acgd.tasks.settings import TaskConfig


@dataclass(frozen=True)
class Label:
    """Policy and condition of an episode."""

    control: str
    """none for a student; else the control: replay, replay-nearest, expert or expert-nominal."""
    task: str
    goal: str
    """training, oracle, commanded, or none for a policy without a goal."""
    image_features: str
    """own, shuffled, or none for a policy without images."""
    start: str


@dataclass(frozen=True)
class Episode:
    """One finished episode. final, held, once: success by each rule. reward: sum with the task's default weights."""

    label: Label
    seed: int
    final: bool
    held: bool
    once: bool
    steps: int
    reward: float

    def to_json(self) -> str:
        """One line of episodes.jsonl."""
        outcome = {"episode_seed": self.seed, "final": self.final, "held": self.held, "once": self.once}
        return json.dumps(asdict(self.label) | outcome | {"steps": self.steps, "return": self.reward})

    @classmethod
    def from_json(cls, line: str) -> "Episode":
        """The episode of one line of episodes.jsonl."""
        row = json.loads(line)
        label = Label(**{name: row.pop(name) for name in Label.__dataclass_fields__})
        return cls(label, seed=row.pop("episode_seed"), reward=row.pop("return"), **row)


def run_batch(
    lock: Lockstep,
    seeds: list[int],
    policy: Policy,
    label: Label,
    task: int = 0,
    goals: Goals = None,
) -> tuple[list[Episode], np.ndarray]:
    """Runs one batch of m seeds. Returns its episodes, and the actions (T, m, A) float32."""
    outcomes = Outcomes()
    roll(lock, policy, seeds, task=task, goals=goals, recorders=[outcomes])
    episodes = [
        Episode(
            label,
            seed,
            **{rule: bool(met) for rule, met in outcomes.success[i].items()},
            steps=int(outcomes.steps[i]),
            reward=float(outcomes.reward[i]),
        )
        for i, seed in enumerate(seeds)
    ]
    return episodes, outcomes.actions


def run(
    lock: Lockstep,
    seeds: list[int],
    policy: Policy,
    label: Label,
    state: Path,
    bar: Bar,
    *,
    task: int = 0,
    goals: Goals = None,
) -> tuple[list[Episode], dict[int, np.ndarray]]:
    """Runs all seeds, batch by batch. Reads finished batches from `state` instead of running them again.

    task: task id of the policy. goals: (E, ...) goals of the seeds, or a function that reads them. Returns the
    episodes in the order of the seeds, and seed -> actions (steps, A).
    """
    name = "-".join((label.control, label.task.replace("/", "-"), label.goal, label.image_features, label.start))
    episodes, actions, size = [], {}, len(lock.envs)
    for first in range(0, len(seeds), size):
        file = state / f"{name}-{first:04d}.safetensors"
        if not file.exists():
            batch_goals = goals[first : first + size] if isinstance(goals, np.ndarray) else goals
            _write_batch(file, *run_batch(lock, seeds[first : first + size], policy, label, task, batch_goals))
        batch, batch_actions = _read_batch(file)
        episodes += batch
        actions |= {episode.seed: batch_actions[: episode.steps, i] for i, episode in enumerate(batch)}
        bar.update(len(batch))
    return episodes, actions


def _write_batch(file: Path, episodes: list[Episode], actions: np.ndarray) -> None:
    """Writes a finished batch. actions: (T, m, A)."""
    notes = {"episodes": "\n".join(episode.to_json() for episode in episodes)}
    replace_file(file, lambda draft: save_file({"actions": np.ascontiguousarray(actions)}, draft, metadata=notes))


def _read_batch(file: Path) -> tuple[list[Episode], np.ndarray]:
    with safe_open(file, "numpy") as batch:
        lines = batch.metadata()["episodes"].splitlines()
        return [Episode.from_json(line) for line in lines], batch.get_tensor("actions")


def write(path: Path, episodes: Iterable[Episode]) -> None:
    """Writes episodes.jsonl: one line per episode."""
    path.write_text("".join(episode.to_json() + "\n" for episode in episodes), encoding="utf-8")


def read(path: Path) -> list[Episode]:
    """Reads episodes.jsonl of an evaluation or of controls."""
    return [Episode.from_json(line) for line in path.read_text(encoding="utf-8").splitlines()]


def write_actions(path: Path, episodes: list[tuple[Episode, np.ndarray]]) -> None:
    """Writes the actions (steps, A) of some episodes as safetensors. The header holds the episodes."""
    arrays = {f"{index}": np.ascontiguousarray(actions) for index, (_, actions) in enumerate(episodes)}
    # One entry in the header: safetensors writes several entries in a random order, so that bytes would differ.
    save_file(arrays, path, metadata={"episodes": "\n".join(episode.to_json() for episode, _ in episodes)})


def read_actions(path: Path) -> list[tuple[Episode, np.ndarray]]:
    """Reads the file of `write_actions`: (episode, actions (steps, A))."""
    with safe_open(path, "numpy") as file:
        lines = file.metadata()["episodes"].splitlines()
        return [(Episode.from_json(line), file.get_tensor(f"{index}")) for index, line in enumerate(lines)]


def seeds_of(task: TaskConfig, split: str, episodes: int, offset: int = 0) -> list[int]:
    """`episodes` seeds of a split, from `offset` on.

    For nominal starts, seeds that repeat the first state of an earlier seed are left out.
    """
    seeds = {"evaluation": SEEDS.evaluation, "validation": SEEDS.validation}[split].take(episodes, offset)
    if task.start == "perturbed":
        return seeds
    env = registry.make(task, image_size=None)
    first = {env.reset(seed=seed)[0]["state"].tobytes(): seed for seed in reversed(seeds)}
    return sorted(first.values())
