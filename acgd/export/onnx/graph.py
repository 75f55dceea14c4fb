"""All of a student that acts, as one module: backbone, goal images, normaliser, networks, memory."""

import torch
from torch import Tensor, nn

from acgd.export.onnx.stepping import Memory, Stepping

INPUTS = ("image", "proprio", "task", "goal")
MEMORY, NEXT = "memory.", "next."
"""Prefixes of the memory among a model's inputs and outputs."""


class Graph(nn.Module):
    """image (B, H, W, 3) uint8, proprio (B, P), task (B,), goal (B,), memory -> action (B, A), memory.

    `goal` is the number of one of the task's goal images; numbers beyond the last begin again with the first.
    """

    def __init__(self, backbone: nn.Module | None, stepping: Stepping, goals: list[Tensor] | None) -> None:
        """goals: for each task (G, F) features, or (G, H, W, 3) uint8 images for a student that owns its CNN."""
        super().__init__()
        self.backbone, self.stepping = backbone, stepping
        self.names = list(stepping.memory)
        self.register_buffer("goals", None if goals is None else nn.utils.rnn.pad_sequence(goals, batch_first=True))
        counts = None if goals is None else torch.tensor([len(of_task) for of_task in goals])
        self.register_buffer("counts", counts)

    def forward(
        self, image: Tensor, proprio: Tensor, task: Tensor, goal: Tensor, *memory: Tensor
    ) -> tuple[Tensor, ...]:
        """`memory` in the order of `names`."""
        action, after = self.stepping(*self.seen(image, proprio, task, goal), dict(zip(self.names, memory)))
        return action, *(after[name] for name in self.names)

    def seen(
        self, image: Tensor, proprio: Tensor, task: Tensor, goal: Tensor
    ) -> tuple[Tensor, Tensor | None, Tensor, Tensor]:
        """Vision, goal, proprio and task, as the stepping takes them."""
        vision = image if self.backbone is None else self.backbone(image)
        chosen = None if self.goals is None else self.goals[task, goal % self.counts[task]]
        return vision, chosen, proprio, task

    def begin(self, rows: int) -> Memory:
        """The memory before the first step."""
        return {name: torch.zeros(rows, *shape, dtype=kind) for name, (shape, kind) in self.stepping.memory.items()}
