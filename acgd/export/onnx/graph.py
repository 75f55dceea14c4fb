"""A student that acts, as one module: backbone, goals, normaliser, networks, memory."""

import torch
from torch import Tensor, nn

from acgd.export.onnx.stepping import Memory, appended, stepping_of
from acgd.students.settings import ActingConfig
from acgd.students.student import Student

INPUTS = ("image", "proprio", "task", "goal")
MEMORY, NEXT = "memory.", "next."
"""Prefixes of the memory among a model's inputs and outputs."""


class Graph(nn.Module):
    """image (B, H, W, 3) uint8, proprio (B, P), task (B,), goal, memory -> action (B, A), memory.

    A student with goal images has them in the module. Its input `goal` (B,) int64 is the number of one of the task's
    goal images, modulo how many there are. With `imitation.goal: vector` the input `goal` is the commanded goal (B, G)
    float32, padded with zeros. Other students ignore `goal`.
    """

    def __init__(
        self, backbone: nn.Module | None, student: Student, acting: ActingConfig, goals: list[Tensor] | None
    ) -> None:
        """goals: for each task (N, F) features of goal images, or (N, H, W, 3) uint8 images for a student with a CNN.

        None for a student without goal images.
        """
        super().__init__()
        self.backbone, self.stepping = backbone, stepping_of(student, acting)
        imitation = student.imitation
        self.vector, self.frames, self.stride = imitation.goal == "vector", imitation.frames, imitation.frame_stride
        self.memory = {"steps": ((), torch.int64), **self.stepping.memory}
        if self.frames > 1:
            kept = (self.frames - 1) * self.stride + 1
            self.memory["frames"] = ((kept, student.sizes.features), torch.float32)
        self.names = list(self.memory)
        self.register_buffer("goals", None if goals is None else nn.utils.rnn.pad_sequence(goals, batch_first=True))
        counts = None if goals is None else torch.tensor([len(of_task) for of_task in goals])
        self.register_buffer("counts", counts)

    def forward(
        self, image: Tensor, proprio: Tensor, task: Tensor, goal: Tensor, *memory: Tensor
    ) -> tuple[Tensor, ...]:
        """`memory` in the order of `names`. Returns the action and the memory of the next step."""
        before = dict(zip(self.names, memory))
        frames = self.recent(image, before)
        action, after = self.stepping(*self.observe(frames, goal, task), proprio, task, before)
        after = {**after, "steps": before["steps"] + 1, "frames": frames}
        return action, *(after[name] for name in self.names)

    def margin(self, image: Tensor, proprio: Tensor, task: Tensor, goal: Tensor, *memory: Tensor) -> Tensor:
        """(B,) lead of the student's likeliest choice. Infinite for a stepping without `margin`."""
        if not hasattr(self.stepping, "margin"):
            return torch.full((len(task),), torch.inf)
        before = dict(zip(self.names, memory))
        return self.stepping.margin(*self.observe(self.recent(image, before), goal, task), proprio, task, before)

    def recent(self, image: Tensor, memory: Memory) -> Tensor:
        """Features of the current frame (B, F), or of all frames in the memory (B, n, F); images without a backbone."""
        newest = image if self.backbone is None else self.backbone(image)
        return newest if self.frames == 1 else appended(memory["frames"], newest, memory["steps"])

    def observe(self, frames: Tensor, goal: Tensor, task: Tensor) -> tuple[Tensor, Tensor | None]:
        """Vision and goal as in Observation."""
        vision = frames if self.frames == 1 else frames[:, :: self.stride].flatten(1)
        if self.vector:
            return vision, goal
        return vision, None if self.goals is None else self.goals[task, goal % self.counts[task]]

    def begin(self, rows: int) -> Memory:
        """The memory before the first step."""
        return {name: torch.zeros(rows, *shape, dtype=kind) for name, (shape, kind) in self.memory.items()}
