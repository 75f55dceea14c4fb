"""From chunks to one action per step, for a batch of environments in lockstep."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor, nn

from acgd.students.ensembling import ensemble
from acgd.students.settings import ActingConfig
from acgd.students.student import Student


@dataclass(frozen=True)
class Memory:
    """What a policy carries from step to step, a row per environment. Rows never mix: environments may end at different times."""

    task: np.ndarray
    """(n,) int64."""
    goal: np.ndarray | None
    """(n, F) goal features, or (n, H, W, 3) uint8 goal images where the student owns its CNN."""
    proprio: np.ndarray
    """(n, h, P) float32, oldest first; before the first step that step's repeats."""
    chunks: np.ndarray
    """(n, k, k, A) float32: [:, i] is the chunk planned i steps ago."""
    steps: np.ndarray
    """(n,) int64, actions taken so far."""


class Actor:
    """A student and its backbone acting on `image` and `proprio`. It takes no state, and reads none."""

    def __init__(self, student: Student, backbone: nn.Module | None, acting: ActingConfig) -> None:
        """`backbone`: frozen, (B, H, W, 3) uint8 -> (B, F); unused by a student that owns its CNN."""
        if backbone is None and not student.sizes.owns_cnn:
            raise ValueError("this student reads features: give the backbone that it was trained with")
        self.student, self.acting = student.eval(), acting
        self.backbone = None if student.sizes.owns_cnn else backbone
        self.device = next(student.parameters()).device

    def reset(
        self, task_ids: Sequence[int], goal_images: np.ndarray | None, seeds: Sequence[int] | None = None
    ) -> Memory:
        """A fresh memory. task_ids (n,); goal_images (n, H, W, 3) uint8, or None for a student trained without.

        `seeds` are for policies that sample; this one takes the likeliest codes.
        """
        config, sizes, n = self.student.config, self.student.sizes, len(task_ids)
        uses_goal = config.goal_image != "off"
        if uses_goal and goal_images is None:
            raise ValueError(
                "this student was trained with a goal image: give goal_images, or train one with codebook.goal_image: off"
            )
        return Memory(
            task=np.asarray(task_ids, np.int64),
            goal=self._see(goal_images).cpu().numpy() if uses_goal else None,
            proprio=np.zeros((n, config.history, sizes.proprio), np.float32),
            chunks=np.zeros((n, config.chunk, config.chunk, sizes.actions), np.float32),
            steps=np.zeros(n, np.int64),
        )

    def act(self, obs: Mapping[str, np.ndarray], memory: Memory) -> tuple[np.ndarray, Memory]:
        """obs: image (n, H, W, 3) uint8, proprio (n, P) -> actions (n, A) float32 in the box, and the next memory."""
        memory = replace(memory, proprio=_remember(obs["proprio"], memory))
        k, age = self.student.config.chunk, memory.steps % self.student.config.chunk
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
        """-> (n, k, A)."""
        goal = None if memory.goal is None else torch.as_tensor(memory.goal, device=self.device)
        proprio, task = (torch.as_tensor(x, device=self.device) for x in (memory.proprio, memory.task))
        return self.student.plan(self._see(images), goal, proprio, task).cpu().numpy()

    @torch.inference_mode()
    def _see(self, images: np.ndarray) -> Tensor:
        """Images (n, H, W, 3) uint8 -> what the student reads of them."""
        pixels = torch.as_tensor(np.ascontiguousarray(images), device=self.device)
        return pixels if self.backbone is None else self.backbone(pixels)


def _remember(proprio: np.ndarray, memory: Memory) -> np.ndarray:
    """The history with the newest proprioception (n, P) last; on a row's first step it fills the whole history."""
    newest = np.asarray(proprio, np.float32)[:, None]
    moved = np.concatenate([memory.proprio[:, 1:], newest], axis=1)
    return np.where((memory.steps == 0)[:, None, None], newest, moved)
