"""Recorded episodes, which all formats of datasets read: one task after another, one episode in memory at a time."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from acgd.export.artifacts import manifest
from acgd.rollouts.dataset import Demonstrations
from acgd.rollouts.store import read_attributes, read_rows
from acgd.simulate.record import FIELDS
from acgd.store.store import ArtifactError
from acgd.tasks import registry
from acgd.tasks.settings import TaskConfig
from acgd.tasks.spec import TASKS

FINAL = ("final_image", "final_proprio", "final_state", "final_integration")
OUTCOMES = ("success_final", "success_held", "success_once", "terminated")
OPTIONAL = ("mean_action", "by_expert")
STEPS = ("proprio", "state", "action", "reward", "solved", "integration")


@dataclass(frozen=True)
class Recording:
    """One episode of T steps."""

    seed: int
    steps: dict[str, np.ndarray]
    """Name -> (T, ...), as in docs/rollouts.md; `image` among them."""
    final: dict[str, np.ndarray]
    """`image`, `proprio`, `state` and `integration` after the last action."""
    outcome: dict[str, bool]
    """`success_final`, `success_held`, `success_once`, `terminated`."""
    model_fields: dict[str, np.ndarray]
    """Fields of the model that the reset wrote."""

    @property
    def length(self) -> int:
        """T."""
        return len(self.steps["action"])

    def whole(self, name: str) -> np.ndarray:
        """An observation over the whole episode, the final one included: (T + 1, ...)."""
        return np.concatenate([self.steps[name], self.final[name][None]])


@dataclass(frozen=True)
class Recordings:
    """One artifact of the stage `rollouts` or `onpolicy`."""

    folder: Path
    manifest: dict[str, Any]

    @classmethod
    def load(cls, folder: Path) -> "Recordings":
        """Reads the manifest. Arrays are read at their first use."""
        return cls(Path(folder), manifest(folder))

    @property
    def task(self) -> TaskConfig:
        """Task and start of the episodes."""
        return TaskConfig(**self.manifest["request"]["task"])

    @property
    def image_size(self) -> int:
        """Height and width of the images, pixels."""
        return self.manifest["request"]["image"]["size"]

    @property
    def instruction(self) -> str:
        """The instruction in words, unique to the task."""
        return f"{self.task.name}: {TASKS[self.task.name].code().__doc__.splitlines()[0].split(': ', 1)[-1]}"

    @cached_property
    def control_step(self) -> float:
        """Seconds."""
        return float(registry.make(self.task, image_size=None).control_step)

    @cached_property
    def stored(self) -> tuple[str, ...]:
        """Names of all arrays."""
        return tuple(read_attributes(self._zarr)["chunks"])

    @cached_property
    def demonstrations(self) -> Demonstrations:
        """All arrays except the images."""
        optional = [name for name in self.stored if name in OPTIONAL or name.startswith(FIELDS)]
        return Demonstrations.load(self.folder, [*STEPS, *FINAL, *OUTCOMES, *optional])

    @property
    def names(self) -> dict[str, tuple[int, int]]:
        """Entry -> first column and one past its last column in `state`; those of `proprio` come first."""
        return {name: (columns.start, columns.stop) for name, columns in self.demonstrations.state_layout.items()}

    def size(self, name: str) -> int:
        """Columns of `proprio`, `state` or `action`."""
        return self.demonstrations.arrays[name].shape[1]

    def __len__(self) -> int:
        return len(self.demonstrations.episode_ends)

    def __iter__(self) -> Iterator[Recording]:
        demos = self.demonstrations
        per_step = [name for name in (*STEPS, *OPTIONAL) if name in demos.arrays]
        fields = [name for name in demos.arrays if name.startswith(FIELDS)]
        for e, (start, stop) in enumerate(zip(demos.episode_starts, demos.episode_ends)):
            steps = {name: demos.arrays[name][start:stop] for name in per_step}
            yield Recording(
                seed=int(demos.seeds[e]),
                steps=steps | {"image": read_rows(self._zarr, "image", int(start), int(stop))},
                final={name.removeprefix("final_"): demos.arrays[name][e] for name in FINAL},
                outcome={name: bool(demos.arrays[name][e]) for name in OUTCOMES},
                model_fields={name.removeprefix(FIELDS): demos.arrays[name][e] for name in fields},
            )

    @property
    def _zarr(self) -> Path:
        return self.folder / "rollouts.zarr"


def load_all(folders: Sequence[Path]) -> list[Recordings]:
    """Recordings of several tasks. ArtifactError where two are of the same task."""
    every = [Recordings.load(folder) for folder in folders]
    tasks = [one.task.name for one in every]
    if len(set(tasks)) < len(tasks):
        raise ArtifactError(
            f"several artifacts are of one task ({', '.join(tasks)}): export one round, or one variant, at a time"
        )
    return every
