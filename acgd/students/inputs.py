"""The normalised inputs of every kind of student. Nothing here can hold the privileged state."""

from typing import NamedTuple

import torch
from torch import Tensor, nn

from acgd.nn.normaliser import Normaliser
from acgd.rollouts.windows import Windows
from acgd.students.data import Observation
from acgd.students.student import Sizes
from acgd.vision.cnn import SmallCNN


class Normalised(NamedTuple):
    """What the networks read."""

    vision: Tensor
    """(B, F), of a recurrent kind (B, k, F)."""
    goal: Tensor | None
    """(B, F), None for a student without a goal image."""
    proprio: Tensor
    """(B, h, P)."""


class StudentInputs(nn.Module):
    """Observation -> normalised features of o_t and o_T, and proprioception."""

    def __init__(self, sizes: Sizes, *, goal_image: bool) -> None:
        super().__init__()
        self.cnn = SmallCNN(sizes.features) if sizes.owns_cnn else None
        self.features = Normaliser(sizes.features)
        self.proprio = Normaliser(sizes.proprio)
        self.goal_image = goal_image

    def fit(self, windows: Windows) -> None:
        """Normalise by the statistics of the training steps."""
        self.proprio.fit(windows.steps["proprio"][windows.training])
        if self.cnn is None:
            self.features.fit(windows.steps["vision"][windows.training])

    def forward(
        self, observation: Observation, noise: float = 0.0, generator: torch.Generator | None = None
    ) -> Normalised:
        """`noise` is the standard deviation of Gaussian noise on the normalised inputs, for training."""

        def perturbed(x: Tensor) -> Tensor:
            return x if noise == 0 else x + noise * torch.randn(x.shape, generator=generator, device=x.device)

        def seen(vision: Tensor) -> Tensor:
            if self.cnn is None:
                return perturbed(self.features(vision))
            return self.cnn(vision.flatten(0, -4)).unflatten(0, vision.shape[:-3])

        if self.goal_image and observation.goal is None:
            raise ValueError(
                "this student was trained with a goal image: give goals, or train one with imitation.goal_image: off"
            )
        goal = seen(observation.goal) if self.goal_image else None
        proprio = perturbed(self.proprio(observation.proprio))
        return Normalised(seen(observation.vision), goal, proprio)
