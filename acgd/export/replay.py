"""Replays exported episodes in the simulator, from the exported files only."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from acgd.rollouts.formats import lerobot, minari, robomimic
from acgd.rollouts.formats.episode import OutsideEpisode
from acgd.store.store import ArtifactError
from acgd.tasks import registry
from acgd.tasks.settings import TaskConfig
from acgd.tasks.snapshot import Snapshot

ACTIONS = ("actions", "action")


@dataclass(frozen=True)
class Replayed:
    """A replayed episode."""

    task: str
    seed: int
    recorded: bool
    """Success of the recording at its last step."""
    replayed: bool
    """Success of the replay at its last step."""
    states: np.ndarray
    """(T + 1, S) float32, the privileged state."""


def read(folder: Path, *, images: bool = False) -> Iterator[OutsideEpisode]:
    """The episodes of an exported dataset of any format. ArtifactError for another folder."""
    if (folder / "meta/info.json").is_file():
        return lerobot.episodes(folder, images=images)
    if any(folder.glob("*.hdf5")):
        return robomimic.episodes(folder, images=images)
    if any(folder.rglob("main_data.hdf5")):
        return minari.episodes(folder, images=images)
    raise ArtifactError(f"{folder} holds no dataset of LeRobot, robomimic or Minari")


def replay(episodes: Iterable[OutsideEpisode]) -> Iterator[Replayed]:
    """Replays the actions of every episode from its first state. ArtifactError for an episode without a first state."""
    env, made = None, None
    for episode in episodes:
        begin = episode.beginning
        if begin is None:
            raise ArtifactError(f"an episode of {episode.task} has no first state: it is no export of acgd")
        config = TaskConfig(**begin.task)
        if config != made:
            env, made = registry.make(config, image_size=None), config
            env.reset(seed=0)
        states = [env.restore(Snapshot(begin.integration, begin.model_fields))["state"]]
        actions = next(episode.columns[name] for name in ACTIONS if name in episode.columns)
        for action in actions:
            observation, *_ = env.step(action)
            states.append(observation["state"])
        success = bool(env.success.outcome()["final"])
        yield Replayed(config.name, begin.seed, begin.outcome["success_final"], success, np.stack(states))
