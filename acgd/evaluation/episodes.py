"""Episodes of an evaluation: how they are run, kept against a kill, and read again.

An episode's outcome depends on its seed, its policy and its row in the batch, never on the episodes beside it or on
their number: seeds go to batches in order, `lockstep` at a time, and policies are padded to that many rows. (With
`image_features: shuffled` it depends on the episode whose image it sees.)
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
    """What kind of episode it is: who acted, and under which condition."""

    control: str
    """none for a student; else which control acts: replay, replay-nearest, expert or expert-nominal."""
    task: str
    goal: str
    """training, oracle, commanded, or none where the policy is given no goal."""
    image_features: str
    """own, shuffled, or none where the policy sees no image."""
    start: str


@dataclass(frozen=True)
class Episode:
    """One finished episode. `reward` is its sum under the task's stock weights."""

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
    """The episodes of one batch, and the actions (T, m, A) float32 that were chosen."""
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
    """All seeds, batch by batch; batches that `state` holds from before a kill are not run again.

    task: the task's id, as the policy counts. goals: (E, ...) of the seeds, or how to read them. Returns the
    episodes in the order of the seeds, and each seed's actions (steps, A).
    """
    name = "-".join((label.control, label.task.replace("/", "-"), label.goal, label.image_features, label.start))
    episodes, actions, size = [], {}, len(lock.envs)
    for at in range(0, len(seeds), size):
        file = state / f"{name}-{at:04d}.safetensors"
        if not file.exists():
            shown = goals[at : at + size] if isinstance(goals, np.ndarray) else goals
            _keep(file, *run_batch(lock, seeds[at : at + size], policy, label, task, shown))
        ended, chosen = _kept(file)
        episodes += ended
        actions |= {e.seed: chosen[: e.steps, i] for i, e in enumerate(ended)}
        bar.update(len(ended))
    return episodes, actions


def _keep(file: Path, episodes: list[Episode], actions: np.ndarray) -> None:
    """A finished batch, whole or not at all."""
    notes = {"episodes": "\n".join(e.to_json() for e in episodes)}
    replace_file(file, lambda draft: save_file({"actions": np.ascontiguousarray(actions)}, draft, metadata=notes))


def _kept(file: Path) -> tuple[list[Episode], np.ndarray]:
    with safe_open(file, "numpy") as batch:
        lines = batch.metadata()["episodes"].splitlines()
        return [Episode.from_json(line) for line in lines], batch.get_tensor("actions")


def write(path: Path, episodes: Iterable[Episode]) -> None:
    """episodes.jsonl: one line per episode."""
    path.write_text("".join(e.to_json() + "\n" for e in episodes), encoding="utf-8")


def read(path: Path) -> list[Episode]:
    """The episodes of an evaluation or of controls."""
    return [Episode.from_json(line) for line in path.read_text(encoding="utf-8").splitlines()]


def write_actions(path: Path, episodes: list[tuple[Episode, np.ndarray]]) -> None:
    """A safetensors file with the actions (steps, A) of some episodes, and in its header which episodes these are."""
    arrays = {f"{at}": np.ascontiguousarray(actions) for at, (_, actions) in enumerate(episodes)}
    # One entry in the header: safetensors writes several in an order of its own, and bytes would not repeat.
    save_file(arrays, path, metadata={"episodes": "\n".join(episode.to_json() for episode, _ in episodes)})


def read_actions(path: Path) -> list[tuple[Episode, np.ndarray]]:
    """What `write_actions` wrote."""
    with safe_open(path, "numpy") as file:
        lines = file.metadata()["episodes"].splitlines()
        return [(Episode.from_json(line), file.get_tensor(f"{at}")) for at, line in enumerate(lines)]


def seeds_of(task: TaskConfig, split: str, episodes: int, offset: int = 0) -> list[int]:
    """The seeds of a split from `offset` on.

    From the nominal start only those are left that do not repeat an earlier episode.
    """
    seeds = {"evaluation": SEEDS.evaluation, "validation": SEEDS.validation}[split].take(episodes, offset)
    if task.start == "perturbed":
        return seeds
    env = registry.make(task, image_size=None)
    first = {env.reset(seed=seed)[0]["state"].tobytes(): seed for seed in reversed(seeds)}
    return sorted(first.values())
