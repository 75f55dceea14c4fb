"""A policy that turns chunks into one action per step (Section III-A), for environments in lockstep."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import torch

from acgd.students.data import Observation
from acgd.students.ensembling import ensemble
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
    """(n, ...) in the form of Observation. None: no goal."""
    proprio: np.ndarray
    """(n, h, P) float32, oldest first. The first step's proprioception fills the steps before it."""
    chunks: np.ndarray
    """(n, k, k, A) float32: [:, i] is the chunk planned i steps ago. With open-loop only [:, 0] is used."""
    steps: np.ndarray
    """(n,) int64, actions taken so far."""


class ChunkPolicy:
    """Policy of a student that plans chunks. It reads `vision` and `proprio`, and no privileged state."""

    def __init__(self, student: Student, acting: ActingConfig) -> None:
        self.student, self.acting = student.eval(), acting

    def start(self, tasks: np.ndarray, goals: np.ndarray | None, seeds: list[int]) -> Memory:
        """The memory before the first step. tasks (n,); goals in the form of Observation.

        The policy ignores `seeds`, since it takes the likeliest chunk.
        """
        settings, sizes, n = self.student.settings, self.student.sizes, len(tasks)
        return Memory(
            task=np.asarray(tasks, np.int64),
            goal=goals,
            proprio=np.zeros((n, settings.history, sizes.proprio), np.float32),
            chunks=np.zeros((n, settings.chunk, settings.chunk, sizes.actions), np.float32),
            steps=np.zeros(n, np.int64),
        )

    def act(self, obs: Mapping[str, np.ndarray], memory: Memory) -> tuple[np.ndarray, Memory]:
        """obs: vision as in Observation, proprio (n, P) -> actions (n, A) float32 in the box, and the next memory."""
        memory = replace(memory, proprio=_append(obs["proprio"], memory))
        k, age = self.student.settings.chunk, memory.steps % self.student.settings.chunk
        rows = np.arange(len(age))
        if self.acting.mode != "open-loop" or (age == 0).any():
            plan = self._plan(obs["vision"], memory)
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
    def _plan(self, vision: np.ndarray, memory: Memory) -> np.ndarray:
        """The student's chunks (n, k, A)."""
        device = next(self.student.parameters()).device
        return self.student.plan(to_observation(vision, memory.goal, memory.proprio, memory.task, device)).cpu().numpy()


def to_observation(
    vision: np.ndarray, goal: np.ndarray | None, proprio: np.ndarray, task: np.ndarray, device: torch.device
) -> Observation:
    """The arrays as tensors on `device`."""
    arrays = (vision, goal, proprio, task)
    return Observation(*(None if array is None else torch.as_tensor(array, device=device) for array in arrays))


def _append(proprio: np.ndarray, memory: Memory) -> np.ndarray:
    """Appends proprioception (n, P) to the history (n, h, P). On a row's first step it fills the whole history."""
    newest = np.asarray(proprio, np.float32)[:, None]
    appended = np.concatenate([memory.proprio[:, 1:], newest], axis=1)
    return np.where((memory.steps == 0)[:, None, None], newest, appended)
