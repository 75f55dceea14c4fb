"""From chunks to one action per step, for a batch of environments in lockstep."""

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
    """What a policy carries from step to step, a row per environment.

    Rows never mix: environments may end at different times.
    """

    task: np.ndarray
    """(n,) int64."""
    goal: np.ndarray | None
    """(n, F) features of goal images, or (n, H, W, 3) uint8 images where the student owns its CNN; or commanded goals
    (n, G)."""
    proprio: np.ndarray
    """(n, h, P) float32, oldest first; before the first step that step's repeats."""
    chunks: np.ndarray
    """(n, k, k, A) float32: [:, i] is the chunk planned i steps ago."""
    steps: np.ndarray
    """(n,) int64, actions taken so far."""


class ChunkPolicy:
    """A student that plans chunks, acting on `vision` and `proprio`. It takes no state, and reads none."""

    def __init__(self, student: Student, acting: ActingConfig) -> None:
        self.student, self.acting = student.eval(), acting

    def start(self, tasks: np.ndarray, goals: np.ndarray | None, seeds: list[int]) -> Memory:
        """tasks (n,); goals as in an Observation, or None for a student trained without.

        `seeds` are for policies that sample; this one takes the likeliest chunk.
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
        """obs: vision (n, ...) as in an Observation, proprio (n, P) -> actions (n, A) float32 in the box, and the next memory."""
        memory = replace(memory, proprio=_remember(obs["proprio"], memory))
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
        """-> (n, k, A)."""
        device = next(self.student.parameters()).device
        return self.student.plan(observation(vision, memory.goal, memory.proprio, memory.task, device)).cpu().numpy()


def observation(
    vision: np.ndarray, goal: np.ndarray | None, proprio: np.ndarray, task: np.ndarray, device: torch.device
) -> Observation:
    """The arrays as tensors on a device."""
    given = (vision, goal, proprio, task)
    return Observation(*(None if x is None else torch.as_tensor(x, device=device) for x in given))


def _remember(proprio: np.ndarray, memory: Memory) -> np.ndarray:
    """The history with the newest proprioception (n, P) last; on a row's first step it fills the whole history."""
    newest = np.asarray(proprio, np.float32)[:, None]
    moved = np.concatenate([memory.proprio[:, 1:], newest], axis=1)
    return np.where((memory.steps == 0)[:, None, None], newest, moved)
