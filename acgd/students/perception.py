"""Vision of an acting student: features of its frozen backbone, or images for a student with a CNN."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import nn

from acgd.simulate.policy import Observations, Policy
from acgd.students.settings import ImitationConfig
from acgd.students.student import Sizes


@dataclass(frozen=True)
class Memory:
    """State of Perception between steps, one row per environment."""

    inner: Any
    frames: np.ndarray | None = None
    """(n, (frames - 1) stride + 1, F) of the last steps, oldest first. None before the first step."""


class Perception:
    """Wraps the policy of a student: converts images and goals to the form of its training data (Observation)."""

    def __init__(
        self,
        policy: Policy,
        backbone: nn.Module | None,
        imitation: ImitationConfig,
        sizes: Sizes,
        device: torch.device,
    ) -> None:
        """backbone: frozen, (B, H, W, 3) uint8 -> (B, F); None for a student with a CNN."""
        self.policy, self.backbone, self.device = policy, backbone, device
        self.imitation, self.sizes = imitation, sizes

    def start(self, tasks: np.ndarray, goals: np.ndarray | None, seeds: list[int]) -> Memory:
        """goals: images (n, H, W, 3) uint8, or commanded goals (n, G of the task) for `imitation.goal: vector`.

        Raises ValueError where the goals that the student needs are missing or of the other form.
        """
        return Memory(self.policy.start(tasks, self._goals(goals), seeds))

    def act(self, observations: Observations, memory: Memory) -> tuple[np.ndarray, Memory]:
        """observations: image (n, H, W, 3) uint8, proprio (n, P). The inner policy gets `vision` for image."""
        newest, frames = self._vision(observations["image"]), self.imitation.frames
        vision, kept = newest, None
        if frames > 1:
            stride = self.imitation.frame_stride
            if memory.frames is None:
                kept = np.repeat(newest[:, None], (frames - 1) * stride + 1, axis=1)
            else:
                kept = np.concatenate([memory.frames[:, 1:], newest[:, None]], axis=1)
            vision = kept[:, ::stride].reshape(len(newest), -1)
        entries = {name: value for name, value in observations.items() if name != "image"} | {"vision": vision}
        actions, inner = self.policy.act(entries, memory.inner)
        return actions, Memory(inner, kept)

    @torch.inference_mode()
    def _vision(self, images: np.ndarray) -> np.ndarray:
        """Features (n, F), or the images."""
        images = np.ascontiguousarray(images)
        if self.backbone is None:
            return images
        return self.backbone(torch.as_tensor(images, device=self.device)).cpu().numpy()

    def _goals(self, goals: np.ndarray | None) -> np.ndarray | None:
        """Features (n, F), images, or commanded goals (n, G); None for a student without a goal."""
        kind = self.imitation.goal
        if kind == "off":
            return None
        form = "commanded goals (n, G)" if kind == "vector" else "goal images (n, H, W, 3)"
        if goals is None or (kind == "vector") != (goals.ndim == 2):
            state = "there are none" if goals is None else f"these have shape {goals.shape}"
            raise ValueError(
                f"this student was trained with imitation.goal: {kind}, and {state}. Give {form}, or train a student "
                "with imitation.goal: off."
            )
        if kind != "vector":
            return self._vision(goals)
        return np.pad(np.asarray(goals, np.float32), ((0, 0), (0, self.sizes.goal - goals.shape[1])))
