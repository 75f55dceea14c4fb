"""phi_task: what to do, from the current image, the goal image and the task (Section III-C)."""

import torch
from torch import Tensor, nn


class TaskEncoder(nn.Module):
    """Features of o_t and, unless it is switched off, of o_T, with an embedding of the task t_i."""

    def __init__(self, features: int, tasks: int, width: int, expansion: int, goal_image: bool) -> None:
        super().__init__()
        hidden = expansion * width
        self.task = nn.Embedding(tasks, width)
        self.features = nn.Linear(features * (2 if goal_image else 1), hidden)
        self.task_to_hidden = nn.Linear(width, hidden, bias=False)
        self.net = nn.Sequential(nn.LayerNorm(hidden), nn.ReLU(), nn.Linear(hidden, width))
        self.goal_image = goal_image

    def forward(self, features: Tensor, goal: Tensor | None, task: Tensor) -> Tensor:
        """features, goal (B, F), normalised; task (B,) -> z_task (B, d)."""
        if self.goal_image and goal is None:
            raise ValueError(
                "this student was trained with a goal image: give goal features, or train one with codebook.goal_image: off"
            )
        seen = torch.cat([features, goal], dim=-1) if self.goal_image else features
        return self.net(self.features(seen) + self.task_to_hidden(self.task(task)))
