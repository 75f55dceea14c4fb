"""The demonstrations of one task, in memory."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from acgd.rollouts.store import read_attributes, read_group

VALIDATION_FRACTION = 0.1
SPLIT_SEED = 0

BOOKKEEPING = ("episode_ends", "seed")
"""Arrays that `load` always reads."""


@dataclass(frozen=True)
class Demonstrations:
    """E episodes on one time axis of T steps. Arrays: docs/rollouts.md."""

    arrays: dict[str, np.ndarray]
    """Name -> (T, ...) per step, or (E, ...) per episode."""
    episode_ends: np.ndarray
    """(E,) int64, exclusive end of each episode."""
    seeds: np.ndarray
    """(E,) int64, seed of each episode."""
    reward_terms: tuple[str, ...]
    """Names of the columns of `reward_terms`."""
    state_layout: dict[str, slice]
    """Name -> columns of `state`."""

    @classmethod
    def load(cls, artifact_dir: Path, arrays: Sequence[str], *, failures: bool = False) -> "Demonstrations":
        """Reads the named arrays of a `rollouts` artifact, or of its failed episodes.

        DamagedStoreError where a chunk is missing or damaged. FileNotFoundError where failures were not kept.
        """
        path = Path(artifact_dir) / "rollouts.zarr"
        attributes = read_attributes(path)
        layout = {name: slice(*columns) for name, columns in attributes["state_layout"].items()}
        if failures:
            path = path / "failures"
            if not path.is_dir():
                raise FileNotFoundError(
                    f"no {path}: set rollouts.keep_failures: true, unless summary.json says that no episode failed"
                )
        read = read_group(path, sorted({*arrays, *BOOKKEEPING}))
        return cls(
            {name: read[name] for name in arrays},
            read["episode_ends"],
            read["seed"],
            tuple(attributes["reward_terms"]),
            layout,
        )

    @property
    def episode_starts(self) -> np.ndarray:
        """(E,) int64, first step of each episode."""
        return np.concatenate([[0], self.episode_ends[:-1]]).astype(np.int64)

    @property
    def lengths(self) -> np.ndarray:
        """(E,) steps of each episode."""
        return self.episode_ends - self.episode_starts

    def split(
        self, validation_fraction: float = VALIDATION_FRACTION, seed: int = SPLIT_SEED
    ) -> tuple[np.ndarray, np.ndarray]:
        """Sorted indices of training and validation episodes. Neither is empty: a single episode is in both."""
        episodes = len(self.episode_ends)
        if episodes == 1:
            return np.zeros(1, np.int64), np.zeros(1, np.int64)
        held_out = min(max(round(validation_fraction * episodes), 1), episodes - 1)
        order = np.random.default_rng(seed).permutation(episodes)
        return np.sort(order[held_out:]), np.sort(order[:held_out])

    def steps_of(self, episodes: np.ndarray) -> np.ndarray:
        """Indices on the time axis of all steps of `episodes`, in the order of `episodes`."""
        starts, ends = self.episode_starts, self.episode_ends
        return np.concatenate([np.arange(starts[e], ends[e]) for e in episodes] or [np.zeros(0, np.int64)])
