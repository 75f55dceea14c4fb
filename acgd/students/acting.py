"""A policy that turns chunks into one action per step (Section III-A), for environments in lockstep."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import torch

from acgd.students.data import Observation
from acgd.students.ensembling import ensemble
from acgd.students.perception import Perception
from acgd.students.settings import ActingConfig
from acgd.students.student import Student


@dataclass(frozen=True)
class Memory:
    """State of the policy between steps, one row per environment.

    Rows are independent, since environments may end at different times.
    """

    task: np.ndarray
    """(n,) int64."""
    goal: np.ndarray | None
    """(n, F) goal features, or (n, H, W, 3) uint8 goal images for a student with a CNN. None: no goal image."""
    proprio: np.ndarray
    """(n, h, P) float32, oldest first. The first step's proprioception fills the steps before it."""
    chunks: np.ndarray
    """(n, k, k, A) float32: [:, i] is the chunk planned i steps ago. With open-loop only [:, 0] is used."""
    steps: np.ndarray
    """(n,) int64, actions taken so far."""


class ChunkPolicy:
    """Policy of a student that plans chunks. It reads `image` and `proprio`, and no privileged state."""

    def __init__(self, student: Student, perception: Perception, acting: ActingConfig) -> None:
        self.student, self.perception, self.acting = student.eval(), perception, acting

    def start(self, tasks: np.ndarray, goals: np.ndarray | None, seeds: list[int]) -> Memory:
        """The memory before the first step. tasks (n,); goals (n, H, W, 3) uint8, or None without goal images.

        The policy ignores `seeds`, since it takes the likeliest chunk. Raises ValueError where goal images are missing.
        """
        settings, sizes, n = self.student.settings, self.student.sizes, len(tasks)
        return Memory(
            task=np.asarray(tasks, np.int64),
            goal=self.perception.see_goals(goals),
            proprio=np.zeros((n, settings.history, sizes.proprio), np.float32),
            chunks=np.zeros((n, settings.chunk, settings.chunk, sizes.actions), np.float32),
            steps=np.zeros(n, np.int64),
        )

    def act(self, obs: Mapping[str, np.ndarray], memory: Memory) -> tuple[np.ndarray, Memory]:
        """obs: image (n, H, W, 3) uint8, proprio (n, P) -> actions (n, A) float32 in the box, and the next memory."""
        memory = replace(memory, proprio=_append(obs["proprio"], memory))
        k, age = self.student.settings.chunk, memory.steps % self.student.settings.chunk
        rows = np.arange(len(age))
        if self.acting.mode != "open-loop" or (age == 0).any():
            plan = self._plan(obs["image"], memory)
            if self.acting.mode == "open-loop":
                plan = np.where((age == 0)[:, None, None], plan, memory.chunks[:, 0])
                chunks = np.concatenate([plan[:, None], memory.chunks[:, 1:]], axis=1)
            else:
                chunks = np.concatenate([plan[:, None], memory.chunks[:, :-1]], axis=1)
            memory = replace(memory, chunks=chunks)
        if self.acting.mode == "open-loop":
            actions = memory.chunks[rows, 0, age]
        elif self.acting.mode == "first":
            actions = memory.chunks[:, 0, 0]
        else:
            ages = np.arange(k)
            actions = ensemble(
                memory.chunks[:, ages, ages], np.minimum(memory.steps, k - 1), self.acting.mode, self.acting.eta
            )
        return actions, replace(memory, steps=memory.steps + 1)

    @torch.inference_mode()
    def _plan(self, images: np.ndarray, memory: Memory) -> np.ndarray:
        """The student's chunks for images (n, H, W, 3) -> (n, k, A)."""
        goal, proprio, task = (self.perception.tensor(x) for x in (memory.goal, memory.proprio, memory.task))
        return self.student.plan(Observation(self.perception.see(images), goal, proprio, task)).cpu().numpy()


def _append(proprio: np.ndarray, memory: Memory) -> np.ndarray:
    """Appends proprioception (n, P) to the history (n, h, P). On a row's first step it fills the whole history."""
    newest = np.asarray(proprio, np.float32)[:, None]
    appended = np.concatenate([memory.proprio[:, 1:], newest], axis=1)
    return np.where((memory.steps == 0)[:, None, None], newest, appended)
