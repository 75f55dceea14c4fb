"""How far a model is from the student that it was made from: step by step, on recorded and on random inputs."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch

from acgd.export.onnx.graph import INPUTS, MEMORY, Graph
from acgd.simulate.policy import Policy

TIE = 1e-5
"""Steps in which the likeliest choice leads by less are left out."""


@dataclass(frozen=True)
class Parity:
    """The largest differences over all steps that count."""

    action: float
    """Of an action between model and torch."""
    memory: float
    """Of anything in the memory."""
    policy: float
    """Between the torch module that was exported and the student's own policy."""
    steps: int
    """That count."""
    ties: int
    """That were left out."""


class Inputs(NamedTuple):
    """n episodes of T steps of one task."""

    images: np.ndarray
    """(T, n, H, W, 3) uint8"""
    proprio: np.ndarray
    """(T, n, P) float32"""
    task: int
    goals: np.ndarray
    """(n,) int64"""
    goal_images: np.ndarray | None
    """(n, H, W, 3) uint8, those that the numbers mean."""


def random_inputs(recorded: Inputs, rng: np.random.Generator) -> Inputs:
    """Of the same shapes: noise for images, and proprioception spread as in the recording."""
    images = rng.integers(0, 256, recorded.images.shape, dtype=np.uint8)
    spread = recorded.proprio.std((0, 1)) + 1e-3
    proprio = recorded.proprio.mean((0, 1)) + spread * rng.standard_normal(recorded.proprio.shape)
    return recorded._replace(images=images, proprio=proprio.astype(np.float32))


def measure(session, graph: Graph, policy: Policy, inputs: list[Inputs]) -> Parity:
    """session: of onnxruntime, or None for module and policy alone.

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

    A row whose policy has met a tie is not compared to the policy from there on: its memory may hold another choice.
    """
    n = inputs.images.shape[1]
    task = np.full(n, inputs.task)
    memory, own = graph.begin(n), policy.start(task, inputs.goal_images, list(range(n)))
    least = np.full(n, np.inf)
    for image, proprio in zip(inputs.images, inputs.proprio):
        given = [torch.from_numpy(value) for value in (image, proprio, task, inputs.goals)]
        margin = _margin(graph, given, memory)
        wanted = [value.numpy() for value in graph(*given, *memory.values())]
        got = wanted if session is None else _run(session, (image, proprio, task, inputs.goals), memory)
        acted, own = policy.act({"image": image, "proprio": proprio}, own)
        differences = [_largest(a, b) for a, b in zip(got, wanted)]
        least = np.minimum(least, margin)
        of_policy = np.where(least < TIE, 0.0, _largest(acted, wanted[0]))
        yield np.stack([differences[0], np.max(differences[1:], axis=0), of_policy, margin], 1)
        memory = dict(zip(memory, map(torch.from_numpy, wanted[1:])))


def _run(session, given: tuple[np.ndarray, ...], memory: dict[str, torch.Tensor]) -> list[np.ndarray]:
    """Outputs of the model. Inputs that the student does not use are not in it."""
    fed = dict(zip(INPUTS, given)) | {MEMORY + name: value.numpy() for name, value in memory.items()}
    return session.run(None, {one.name: fed[one.name] for one in session.get_inputs()})


def _margin(graph: Graph, given: list[torch.Tensor], memory: dict[str, torch.Tensor]) -> np.ndarray:
    """(n,) by how much the student's choice leads; infinite where its kind has none."""
    margin = getattr(graph.stepping, "margin", None)
    return margin(*graph.seen(*given), memory).numpy() if margin else np.full(len(given[0]), np.inf)


def _largest(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """(n, ...) each -> (n,)."""
    return np.abs(one.astype(np.float64) - other.astype(np.float64)).reshape(len(one), -1).max(1)
