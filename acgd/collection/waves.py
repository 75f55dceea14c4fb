"""Waves of episodes, which are saved one by one, and the rollout store that is written from them."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from safetensors import safe_open
from safetensors.numpy import save_file

from acgd.rollouts.store import write_group
from acgd.simulate.record import FIELDS, FINAL, ONCE, TERMS, Episode
from acgd.store.atomic import replace_file
from acgd.tasks import registry
from acgd.tasks.settings import TaskConfig

STORE = "rollouts.zarr"


@dataclass(frozen=True)
class StoredEpisode:
    """An episode of a saved wave. Each access reads one array, since all images together may exceed the memory."""

    file: Path
    index: int

    def names(self) -> list[str]:
        """Names of the arrays."""
        with safe_open(self.file, "numpy") as arrays:
            return [name.partition("/")[2] for name in arrays.keys() if name.startswith(f"{self.index}/")]

    def __getitem__(self, name: str) -> np.ndarray:
        with safe_open(self.file, "numpy") as arrays:
            return arrays.get_tensor(f"{self.index}/{name}")


def wave(state: Path, seeds: Sequence[int], run: Callable[[list[int]], list[Episode]]) -> list[StoredEpisode]:
    """The episodes of `seeds`: read from a file in `state` if it exists, else run by `run` and saved there."""
    file = state / f"wave-{seeds[0]}.safetensors"
    if not file.exists():
        episodes = enumerate(run(list(seeds)))
        arrays = {f"{i}/{name}": np.asarray(value) for i, episode in episodes for name, value in episode.items()}
        replace_file(file, lambda draft: save_file(arrays, draft))
    return [StoredEpisode(file, i) for i in range(len(seeds))]


def write_rollouts(
    out: Path, task: TaskConfig, episodes: Sequence[StoredEpisode], failures: Sequence[StoredEpisode] = ()
) -> None:
    """Writes rollouts.zarr (arrays: docs/rollouts.md). `failures` go into the group of that name."""
    layout = registry.make(task, image_size=None).state_layout
    attributes = {
        "task": task.name,
        "reward_terms": reward_terms(episodes[0]),
        "state_layout": {name: [columns.start, columns.stop] for name, columns in layout.items()},
    }
    write_group(out / STORE, stack_episodes(episodes), attributes)
    if failures:
        write_group(out / STORE / "failures", stack_episodes(failures), {})


def reward_terms(episode: StoredEpisode) -> list[str]:
    """Names of the reward's terms, in the order of the columns of the array `reward_terms`."""
    return sorted(name.removeprefix(TERMS) for name in episode.names() if name.startswith(TERMS))


def stack_episodes(episodes: Sequence[StoredEpisode]) -> dict[str, np.ndarray]:
    """The arrays of the store: per-step arrays concatenated (T, ...), per-episode arrays stacked (E, ...)."""
    names = [name for name in episodes[0].names() if not name.startswith(TERMS)]
    stacked = {}
    for name in names:
        per_episode = name in ONCE or name.startswith((FINAL, FIELDS))
        stacked[name] = (np.stack if per_episode else np.concatenate)([episode[name] for episode in episodes])
    terms = [np.concatenate([episode[TERMS + name] for episode in episodes]) for name in reward_terms(episodes[0])]
    stacked["reward_terms"] = np.stack(terms, axis=1)
    stacked["episode_ends"] = np.cumsum([len(episode["reward"]) for episode in episodes]).astype(np.int64)
    return stacked


def steps(episodes: Sequence[StoredEpisode]) -> int:
    """Sum of the environment steps of all episodes."""
    return sum(len(episode["reward"]) for episode in episodes)
