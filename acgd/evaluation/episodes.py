"""Episodes in lockstep: how they are run, kept against a kill, and read again.

What an episode gives depends on its seed, its policy and its row in the batch, never on the episodes beside it or on how
many there are: seeds go to batches in order, `lockstep` at a time, and a policy computes that many rows however many
episodes are left, since a matrix product may round differently for another number of rows. (The shuffled-image control
takes another episode's image, and so depends on it by design.)
"""

import json
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from safetensors import safe_open
from safetensors.numpy import save_file

from acgd.experts.policy import Expert
from acgd.simulate.lockstep import Lockstep
from acgd.simulate.seeds import SEEDS
from acgd.store.atomic import replace_file
from acgd.store.progress import Bar
from acgd.tasks import registry
from acgd.tasks.settings import TaskConfig

Policy = Callable[[dict[str, np.ndarray], int], np.ndarray]
"""(stacked observations of m episodes, time step) -> actions (m, A)."""


@dataclass(frozen=True)
class Label:
    """What kind of episode it is: who acted, and under which condition."""

    control: str
    """none for a student; else which control acts: replay, replay-nearest, expert or expert-nominal."""
    task: str
    goal: str
    """training, oracle, or none where the policy is given no goal image."""
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


def roll(lock: Lockstep, seeds: list[int], policy: Policy, label: Label) -> tuple[list[Episode], np.ndarray]:
    """Runs one batch to its end. Returns its episodes, and the actions (T, m, A) float32 that were chosen."""
    obs = lock.reset(seeds)
    reward, steps, chosen = np.zeros(len(seeds)), np.zeros(len(seeds), np.int64), []
    while lock.active.any():
        steps += lock.active
        chosen.append(np.asarray(policy(obs, len(chosen)), np.float32))
        obs, gained, _, infos = lock.step(chosen[-1])
        reward += gained
    episodes = [
        Episode(
            label,
            seed,
            **{rule: bool(met) for rule, met in infos[i]["success"].items()},
            steps=int(steps[i]),
            reward=float(reward[i]),
        )
        for i, seed in enumerate(seeds)
    ]
    return episodes, np.stack(chosen)


def run(
    lock: Lockstep, seeds: list[int], policy_for: Callable[[list[int]], Policy], label: Label, state: Path, bar: Bar
) -> tuple[list[Episode], dict[int, np.ndarray]]:
    """All seeds, batch by batch; batches that `state` holds from before a kill are not run again.

    Returns the episodes in the order of the seeds, and each seed's actions (steps, A).
    """
    name = "-".join((label.control, label.task.replace("/", "-"), label.goal, label.image_features, label.start))
    episodes, actions, size = [], {}, len(lock.envs)
    for at in range(0, len(seeds), size):
        batch, file = seeds[at : at + size], state / f"{name}-{at:04d}.safetensors"
        if not file.exists():
            _keep(file, *roll(lock, batch, policy_for(batch), label))
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
        return [Episode.from_json(line) for line in batch.metadata()["episodes"].splitlines()], batch.get_tensor(
            "actions"
        )


def write(path: Path, episodes: Iterable[Episode]) -> None:
    """episodes.jsonl: one line per episode."""
    path.write_text("".join(e.to_json() + "\n" for e in episodes), encoding="utf-8")


def read(path: Path) -> list[Episode]:
    """The episodes of an evaluation or of controls."""
    return [Episode.from_json(line) for line in path.read_text(encoding="utf-8").splitlines()]


def seeds_of(task: TaskConfig, split: str, episodes: int) -> list[int]:
    """The first seeds of a split; from the nominal start only those that do not repeat an earlier episode."""
    seeds = {"evaluation": SEEDS.evaluation, "validation": SEEDS.validation}[split].take(episodes)
    if task.start == "perturbed":
        return seeds
    env = registry.make(task, image=False)
    first = {env.reset(seed=seed)[0]["state"].tobytes(): seed for seed in reversed(seeds)}
    return sorted(first.values())


def expert_policy(expert: Expert, size: int) -> Policy:
    """The expert's mean action on the privileged state, computed `size` rows at a time."""

    def act(obs: dict[str, np.ndarray], step: int) -> np.ndarray:
        return expert.mean(padded(obs["state"], size))[: len(obs["state"])]

    return act


def padded(rows: np.ndarray, size: int) -> np.ndarray:
    """(m, ...) -> (size, ...), the last row repeated."""
    return np.concatenate([rows, np.repeat(rows[-1:], size - len(rows), axis=0)]) if len(rows) < size else rows
