"""The normalised inputs of every kind of student. Nothing here can hold the privileged state."""

from typing import NamedTuple

import torch
from torch import Tensor, nn

from acgd.nn.normaliser import CLIP, Normaliser
from acgd.rollouts.windows import Windows
from acgd.students.data import Observation
from acgd.students.settings import ImitationConfig
from acgd.students.student import Sizes
from acgd.vision.cnn import SmallCNN


class Normalised(NamedTuple):
    """What the networks read. The widths are those of StudentInputs."""

    vision: Tensor
    """(B, vision_width)."""
    goal: Tensor | None
    """(B, goal_width), None for a student without a goal."""
    proprio: Tensor
    """(B, h, P)."""


class StudentInputs(nn.Module):
    """Observation -> normalised features of o_t and earlier frames, of the goal, and proprioception."""

    def __init__(self, imitation: ImitationConfig, sizes: Sizes) -> None:
        super().__init__()
        self.cnn = SmallCNN(sizes.features) if sizes.owns_cnn else None
        self.features = Normaliser(sizes.features)
        self.proprio = Normaliser(sizes.proprio)
        self.commanded = GoalNormaliser(sizes.tasks, sizes.goal) if imitation.goal == "vector" else None
        self.frames, self.uses_goal = imitation.frames, imitation.goal != "off"
        self.vision_width = imitation.frames * sizes.features
        self.goal_width = {"vector": sizes.goal, "off": 0}.get(imitation.goal, sizes.features)
        self.width = self.vision_width + self.goal_width
        """Of vision and goal together."""

    def fit(self, windows: Windows) -> None:
        """Normalise by the statistics of the training steps."""
        self.proprio.fit(windows.steps["proprio"][windows.training])
        if self.cnn is None:
            self.features.fit(windows.steps["vision"][windows.training])
        if self.commanded is not None:
            episodes = windows.episode[windows.training].unique()
            self.commanded.fit(windows.episodes["goal"][episodes], windows.episode_task[episodes])

    def forward(
        self, observation: Observation, noise: float = 0.0, generator: torch.Generator | None = None
    ) -> Normalised:
        """`noise` is the standard deviation of Gaussian noise on the normalised inputs, for training."""

        def perturbed(x: Tensor) -> Tensor:
            return x if noise == 0 else x + noise * torch.randn(x.shape, generator=generator, device=x.device)

        def seen(vision: Tensor, frames: int) -> Tensor:
            if self.cnn is not None:
                return self.cnn(vision)
            return perturbed(self.features(vision.unflatten(-1, (frames, -1))).flatten(-2))

        goal = None
        if self.uses_goal:
            if observation.goal is None:
                raise ValueError(
                    "this student was trained with a goal: give goals, or train one with imitation.goal: off"
                )
            if self.commanded is None:
                goal = seen(observation.goal, 1)
            else:
                goal = perturbed(self.commanded(observation.goal, observation.task))
        proprio = perturbed(self.proprio(observation.proprio))
        return Normalised(seen(observation.vision, self.frames), goal, proprio)


class GoalNormaliser(nn.Module):
    """(goal - mean) / std with the statistics of its own task's training episodes, clipped.

    Goals of different tasks differ far more than those of one, and have other units.
    """

    mean: Tensor
    std: Tensor

    def __init__(self, tasks: int, size: int) -> None:
        super().__init__()
        self.register_buffer("mean", torch.zeros(tasks, size))
        self.register_buffer("std", torch.ones(tasks, size))

    def fit(self, goals: Tensor, task: Tensor) -> None:
        """goals (K, size), task (K,). A number that does not vary, as in the padding, keeps a spread of 1."""
        for i in range(len(self.mean)):
            of_task = goals[task == i]
            std = of_task.std(0, correction=0)
            self.mean[i], self.std[i] = of_task.mean(0), torch.where(std > 1e-5, std, 1.0)

    def forward(self, goal: Tensor, task: Tensor) -> Tensor:
        """goal (B, size), task (B,) -> (B, size)."""
        return ((goal - self.mean[task]) / self.std[task]).clamp(-CLIP, CLIP)
