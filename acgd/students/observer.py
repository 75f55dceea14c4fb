"""phi_state and phi_task, the encoders of the observation of acgd and chunk.

Sizes: B windows; d, the width of every embedding.
"""

import torch
from torch import Tensor, nn

from acgd.students.data import Observation
from acgd.students.inputs import StudentInputs
from acgd.students.settings import ImitationConfig
from acgd.students.student import Sizes
from acgd.students.transformer_settings import TransformerSettings


class StateEncoder(nn.Module):
    """phi_state, an MLP over the robot's recent proprioception: s_{t-h:t} -> z_state (Section III-C).

    The input is proprioception, not the privileged state. The paper writes s for both.
    """

    def __init__(self, settings: TransformerSettings, sizes: Sizes) -> None:
        super().__init__()
        hidden = settings.expansion * settings.width
        self.net = nn.Sequential(
            nn.Linear(settings.history * sizes.proprio, hidden),
            nn.LayerNorm(hidden),
            nn.ReLU(),
            nn.Linear(hidden, settings.width),
        )

    def forward(self, proprio: Tensor) -> Tensor:
        """proprio (B, h, P), normalised -> z_state (B, d)."""
        return self.net(proprio.flatten(1))


class TaskEncoder(nn.Module):
    """phi_task: features of o_t and earlier frames, the goal if it is used, the task t_i -> z_task (Section III-C)."""

    def __init__(self, settings: TransformerSettings, sizes: Sizes, input_size: int) -> None:
        """input_size: width of vision and goal together."""
        super().__init__()
        hidden = settings.expansion * settings.width
        self.task = nn.Embedding(sizes.tasks, settings.width)
        self.features = nn.Linear(input_size, hidden)
        self.task_to_hidden = nn.Linear(settings.width, hidden, bias=False)
        self.net = nn.Sequential(nn.LayerNorm(hidden), nn.ReLU(), nn.Linear(hidden, settings.width))

    def forward(self, vision: Tensor, goal: Tensor | None, task: Tensor) -> Tensor:
        """vision (B, frames F), goal (B, F) or (B, G), normalised; task (B,) -> z_task (B, d)."""
        features = vision if goal is None else torch.cat([vision, goal], dim=-1)
        return self.net(self.features(features) + self.task_to_hidden(self.task(task)))


class Observer(nn.Module):
    """phi_state and phi_task on the normalised observation."""

    def __init__(self, settings: TransformerSettings, imitation: ImitationConfig, sizes: Sizes) -> None:
        super().__init__()
        self.inputs = StudentInputs(imitation, sizes)
        self.state_encoder = StateEncoder(settings, sizes)
        self.task_encoder = TaskEncoder(settings, sizes, self.inputs.width)

    def forward(
        self, observation: Observation, noise: float = 0.0, generator: torch.Generator | None = None
    ) -> tuple[Tensor, Tensor]:
        """z_state, z_task, each (B, d). noise: standard deviation on the normalised inputs."""
        vision, goal, proprio = self.inputs(observation, noise, generator)
        return self.state_encoder(proprio), self.task_encoder(vision, goal, observation.task)
