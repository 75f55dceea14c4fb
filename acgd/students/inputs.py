"""The normalised inputs of every kind of student. They have no place for the privileged state."""

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
    """Inputs of the networks. The widths are those of StudentInputs."""

    vision: Tensor
    """(B, vision_width). For a recurrent kind (B, k, vision_width)."""
    goal: Tensor | None
    """(B, goal_width); None for a student without a goal."""
    proprio: Tensor
    """(B, h, P). For a recurrent kind (B, k, P)."""


class StudentInputs(nn.Module):
    """Observation -> normalised features of o_t and earlier frames, normalised goal and proprioception."""

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
        """Width of vision and goal together."""

    def fit(self, windows: Windows) -> None:
        """Fits the normalisers to the training steps, that of commanded goals to the training episodes."""
        self.proprio.fit(windows.steps["proprio"][windows.training])
        if self.cnn is None:
            self.features.fit(windows.steps["vision"][windows.training])
        if self.commanded is not None:
            episodes = windows.episode[windows.training].unique()
            self.commanded.fit(windows.episodes["goal"][episodes], windows.episode_task[episodes])

    def forward(
        self, observation: Observation, noise: float = 0.0, generator: torch.Generator | None = None
    ) -> Normalised:
        """noise: standard deviation of Gaussian noise on the normalised inputs, for training.

        Raises ValueError where the student uses goals and the observation has none.
        """

        def perturbed(x: Tensor) -> Tensor:
            return x if noise == 0 else x + noise * torch.randn(x.shape, generator=generator, device=x.device)

        def features(vision: Tensor, frames: int) -> Tensor:
            if self.cnn is None:
                return perturbed(self.features(vision.unflatten(-1, (frames, -1))).flatten(-2))
            return self.cnn(vision.flatten(0, -4)).unflatten(0, vision.shape[:-3])

        goal = None
        if self.uses_goal:
            if observation.goal is None:
                raise ValueError(
                    "the observation has no goal, and this student was trained with one. Give goals, or train a "
                    "student with imitation.goal: off."
                )
            if self.commanded is None:
                goal = features(observation.goal, 1)
            else:
                goal = perturbed(self.commanded(observation.goal, observation.task))
        proprio = perturbed(self.proprio(observation.proprio))
        return Normalised(features(observation.vision, self.frames), goal, proprio)


class GoalNormaliser(nn.Module):
    """(goal - mean) / std with the statistics of the task's training episodes, clipped.

    Goals differ far more between tasks than within one, and have other units.
    """

    mean: Tensor
    std: Tensor

    def __init__(self, tasks: int, size: int) -> None:
        super().__init__()
        self.register_buffer("mean", torch.zeros(tasks, size))
        self.register_buffer("std", torch.ones(tasks, size))

    def fit(self, goals: Tensor, task: Tensor) -> None:
        """goals (K, size), task (K,). The standard deviation of a constant component, such as padding, is set to 1."""
        for i in range(len(self.mean)):
            task_goals = goals[task == i]
            std = task_goals.std(0, correction=0)
            self.mean[i], self.std[i] = task_goals.mean(0), torch.where(std > 1e-5, std, 1.0)

    def forward(self, goal: Tensor, task: Tensor) -> Tensor:
        """goal (B, size), task (B,) -> (B, size)."""
        return ((goal - self.mean[task]) / self.std[task]).clamp(-CLIP, CLIP)
