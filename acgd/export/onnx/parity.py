"""Differences between a model and its student, step by step, on recorded and on random inputs."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch

from acgd.export.onnx.graph import INPUTS, MEMORY, Graph
from acgd.simulate.policy import Policy

TIE = 1e-5
"""Steps in which the likeliest choice has a smaller lead are left out."""


@dataclass(frozen=True)
class Parity:
    """The largest differences over all steps that count."""

    action: float
    """Difference of an action between model and torch module."""
    memory: float
    """Difference of an entry of the memory between model and torch module."""
    policy: float
    """Difference of an action between the torch module and the student's policy."""
    steps: int
    """Number of steps that count."""
    ties: int
    """Number of steps that were left out."""


class Inputs(NamedTuple):
    """n episodes of T steps of one task."""

    images: np.ndarray
    """(T, n, H, W, 3) uint8"""
    proprio: np.ndarray
    """(T, n, P) float32"""
    task: int
    goals: np.ndarray
    """The model's input `goal`: (n,) int64 numbers of goal images, or (n, G) float32 commanded goals."""
    policy_goals: np.ndarray | None
    """The same goals for the policy: (n, H, W, 3) uint8 images, or (n, G') float32 commanded goals without padding."""


def random_inputs(recorded: Inputs, rng: np.random.Generator) -> Inputs:
    """Inputs of the same shapes and goals. Images are uniform noise.

    Proprioception is Gaussian with the recorded mean and standard deviation.
    """
    images = rng.integers(0, 256, recorded.images.shape, dtype=np.uint8)
    spread = recorded.proprio.std((0, 1)) + 1e-3
    proprio = recorded.proprio.mean((0, 1)) + spread * rng.standard_normal(recorded.proprio.shape)
    return recorded._replace(images=images, proprio=proprio.astype(np.float32))


def measure(session, graph: Graph, policy: Policy, inputs: list[Inputs]) -> Parity:
    """The differences over all `inputs`. session: of onnxruntime; None compares module and policy only.

    Each step starts from the torch module's memory, so that differences do not add up.
    """
    rows = [row for one in inputs for row in _steps(session, graph, policy, one)]
    table = np.concatenate(rows)
    counted = table[table[:, 3] >= TIE]
    action, memory, of_policy = counted[:, :3].max(0) if len(counted) else (0.0, 0.0, 0.0)
    return Parity(float(action), float(memory), float(of_policy), len(counted), len(table) - len(counted))


@torch.inference_mode()
def _steps(session, graph: Graph, policy: Policy, inputs: Inputs) -> Iterator[np.ndarray]:
    """For each step (n, 4): differences of action, memory and policy, and the margin.

    After a tie a row is no longer compared to the policy, whose memory may hold another choice.
    """
    n = inputs.images.shape[1]
    task = np.full(n, inputs.task)
    memory, policy_memory = graph.begin(n), policy.start(task, inputs.policy_goals, list(range(n)))
    least = np.full(n, np.inf)
    for image, proprio in zip(inputs.images, inputs.proprio):
        tensors = [torch.from_numpy(value) for value in (image, proprio, task, inputs.goals)]
        margin = graph.margin(*tensors, *memory.values()).numpy()
        in_torch = [value.numpy() for value in graph(*tensors, *memory.values())]
        in_onnx = in_torch if session is None else _run(session, (image, proprio, task, inputs.goals), memory)
        action, policy_memory = policy.act({"image": image, "proprio": proprio}, policy_memory)
        differences = [_largest(a, b) for a, b in zip(in_onnx, in_torch)]
        least = np.minimum(least, margin)
        of_policy = np.where(least < TIE, 0.0, _largest(action, in_torch[0]))
        yield np.stack([differences[0], np.max(differences[1:], axis=0), of_policy, margin], 1)
        memory = dict(zip(memory, map(torch.from_numpy, in_torch[1:])))


def _run(session, values: tuple[np.ndarray, ...], memory: dict[str, torch.Tensor]) -> list[np.ndarray]:
    """Outputs of the model. The model has no inputs that the student does not use."""
    every = dict(zip(INPUTS, values)) | {MEMORY + name: value.numpy() for name, value in memory.items()}
    return session.run(None, {one.name: every[one.name] for one in session.get_inputs()})


def _largest(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Largest absolute difference of each row: (n, ...), (n, ...) -> (n,)."""
    return np.abs(one.astype(np.float64) - other.astype(np.float64)).reshape(len(one), -1).max(1)
