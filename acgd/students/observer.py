"""The student's view: normalisation, phi_state and phi_task. Nothing here can hold the privileged state."""

from dataclasses import dataclass, replace

import torch
from torch import Tensor, nn

from acgd.students.state_encoder import StateEncoder
from acgd.students.task_encoder import TaskEncoder
from acgd.vision.cnn import SmallCNN

CLIP = 5.0
"""Normalised inputs end here: a joint that never moved in the demonstrations must not shout at test time."""


@dataclass(frozen=True)
class Observation:
    """All that a student may read. The privileged state is no part of it."""

    vision: Tensor
    """(B, F) features of a frozen backbone, or (B, H, W, 3) uint8 images where the student owns its CNN."""
    goal: Tensor | None
    """The same for the goal image o_T."""
    proprio: Tensor
    """(B, h, P), oldest first; the last row is the current one."""
    task: Tensor
    """(B,) long, index in the study's list of tasks."""

    def first(self, n: int) -> "Observation":
        """The first n rows."""
        return replace(
            self,
            vision=self.vision[:n],
            goal=None if self.goal is None else self.goal[:n],
            proprio=self.proprio[:n],
            task=self.task[:n],
        )


class Normaliser(nn.Module):
    """(x - mean) / std with the training frames' statistics, clipped."""

    mean: Tensor
    std: Tensor

    def __init__(self, size: int) -> None:
        super().__init__()
        self.register_buffer("mean", torch.zeros(size))
        self.register_buffer("std", torch.ones(size))

    def fit(self, x: Tensor) -> None:
        """x (N, size). Spreads far below the typical one are raised to a twentieth of it, so that rounding is not blown up."""
        self.mean.copy_(x.mean(0))
        std = x.std(0)
        self.std.copy_(std.clamp(min=max(0.05 * std.median().item(), 1e-6)))

    def forward(self, x: Tensor) -> Tensor:
        return ((x - self.mean) / self.std).clamp(-CLIP, CLIP)


class Observer(nn.Module):
    """Observation -> z_state, z_task, each (B, d)."""

    def __init__(
        self,
        features: int,
        proprio: int,
        history: int,
        tasks: int,
        width: int,
        expansion: int,
        goal_image: bool,
        owns_cnn: bool,
    ) -> None:
        super().__init__()
        self.cnn = SmallCNN(features) if owns_cnn else None
        self.normalise_features = Normaliser(features)
        self.normalise_proprio = Normaliser(proprio)
        self.state_encoder = StateEncoder(history, proprio, width, expansion)
        self.task_encoder = TaskEncoder(features, tasks, width, expansion, goal_image)

    def forward(
        self, observation: Observation, noise: float = 0.0, generator: torch.Generator | None = None
    ) -> tuple[Tensor, Tensor]:
        """`noise` is the standard deviation of Gaussian noise on the normalised inputs, for training."""

        def seen(vision: Tensor) -> Tensor:
            return perturb(self.normalise_features(vision)) if self.cnn is None else self.cnn(vision)

        def perturb(x: Tensor) -> Tensor:
            return x if noise == 0 else x + noise * torch.randn(x.shape, generator=generator, device=x.device)

        goal = seen(observation.goal) if self.task_encoder.goal_image and observation.goal is not None else None
        z_state = self.state_encoder(perturb(self.normalise_proprio(observation.proprio)))
        return z_state, self.task_encoder(seen(observation.vision), goal, observation.task)
