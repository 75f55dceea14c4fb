"""The normalised inputs of every kind of student. They have no place for the privileged state."""

from typing import NamedTuple

import torch
from torch import Tensor, nn

from acgd.nn.normaliser import Normaliser
from acgd.rollouts.windows import Windows
from acgd.students.data import Observation
from acgd.students.student import Sizes
from acgd.vision.cnn import SmallCNN


class Normalised(NamedTuple):
    """Inputs of the networks."""

    vision: Tensor
    """(B, F)."""
    goal: Tensor | None
    """(B, F); None for a student without a goal image."""
    proprio: Tensor
    """(B, h, P)."""


class StudentInputs(nn.Module):
    """Observation -> normalised features of o_t and o_T, and normalised proprioception."""

    def __init__(self, sizes: Sizes, *, goal_image: bool) -> None:
        super().__init__()
        self.cnn = SmallCNN(sizes.features) if sizes.owns_cnn else None
        self.features = Normaliser(sizes.features)
        self.proprio = Normaliser(sizes.proprio)
        self.goal_image = goal_image

    def fit(self, windows: Windows) -> None:
        """Fits the normalisers to the training steps."""
        self.proprio.fit(windows.steps["proprio"][windows.training])
        if self.cnn is None:
            self.features.fit(windows.steps["vision"][windows.training])

    def forward(
        self, observation: Observation, noise: float = 0.0, generator: torch.Generator | None = None
    ) -> Normalised:
        """noise: standard deviation of Gaussian noise on the normalised inputs, for training.

        Raises ValueError where the student uses goal images and the observation has none.
        """

        def perturbed(x: Tensor) -> Tensor:
            return x if noise == 0 else x + noise * torch.randn(x.shape, generator=generator, device=x.device)

        def features(vision: Tensor) -> Tensor:
            return perturbed(self.features(vision)) if self.cnn is None else self.cnn(vision)

        if self.goal_image and observation.goal is None:
            raise ValueError(
                "the observation has no goal image, and this student was trained with one. Give goal images, or train "
                "a student with imitation.goal_image: off."
            )
        goal = features(observation.goal) if self.goal_image else None
        proprio = perturbed(self.proprio(observation.proprio))
        return Normalised(features(observation.vision), goal, proprio)
