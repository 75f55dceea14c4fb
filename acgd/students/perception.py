"""How a student that acts sees: images become the features of its frozen backbone, of earlier frames too."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import nn

from acgd.simulate.policy import Observations, Policy
from acgd.students.settings import ImitationConfig
from acgd.students.student import Sizes


@dataclass(frozen=True)
class Seen:
    """The memory of a policy that sees, a row per environment."""

    inner: Any
    frames: np.ndarray | None = None
    """(n, (frames - 1) stride + 1, F) of the last steps, oldest first. None before the first step."""


class Perception:
    """A student's policy, given `vision` and goals as they are in its training windows (Observation)."""

    def __init__(
        self,
        policy: Policy,
        backbone: nn.Module | None,
        imitation: ImitationConfig,
        sizes: Sizes,
        device: torch.device,
    ) -> None:
        """`backbone`: frozen, (B, H, W, 3) uint8 -> (B, F); None for a student that owns its CNN."""
        self.policy, self.backbone, self.device = policy, backbone, device
        self.imitation, self.sizes = imitation, sizes

    def start(self, tasks: np.ndarray, goals: np.ndarray | None, seeds: list[int]) -> Seen:
        """goals: images (n, H, W, 3) uint8 or commanded goals (n, G of the task), as the student was trained."""
        return Seen(self.policy.start(tasks, self._goals(goals), seeds))

    def act(self, observations: Observations, memory: Seen) -> tuple[np.ndarray, Seen]:
        """observations: image (n, H, W, 3) uint8, proprio (n, P)."""
        newest, frames = self._see(observations["image"]), self.imitation.frames
        vision, kept = newest, None
        if frames > 1:
            stride = self.imitation.frame_stride
            if memory.frames is None:
                kept = np.repeat(newest[:, None], (frames - 1) * stride + 1, axis=1)
            else:
                kept = np.concatenate([memory.frames[:, 1:], newest[:, None]], axis=1)
            vision = kept[:, ::stride].reshape(len(newest), -1)
        seen = {name: value for name, value in observations.items() if name != "image"} | {"vision": vision}
        actions, inner = self.policy.act(seen, memory.inner)
        return actions, Seen(inner, kept)

    @torch.inference_mode()
    def _see(self, images: np.ndarray) -> np.ndarray:
        """Features (n, F), or the images."""
        if self.backbone is None:
            return images
        return self.backbone(torch.as_tensor(np.ascontiguousarray(images), device=self.device)).cpu().numpy()

    def _goals(self, goals: np.ndarray | None) -> np.ndarray | None:
        """Features (n, F), images, or commanded goals (n, G); None for a student without a goal."""
        kind = self.imitation.goal
        if kind == "off":
            return None
        if goals is None:
            wanted = "commanded goals" if kind == "vector" else "goal images"
            raise ValueError(
                f"this student was trained with goals: give {wanted}, or train one with imitation.goal: off"
            )
        if (kind == "vector") != (goals.ndim == 2):
            raise ValueError(
                f"this student was trained with imitation.goal: {kind}, and is given goals of shape {goals.shape}"
            )
        if kind != "vector":
            return self._see(goals)
        return np.pad(np.asarray(goals, np.float32), ((0, 0), (0, self.sizes.goal - goals.shape[1])))
