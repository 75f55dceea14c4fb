"""A student of the store as a policy."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch

from acgd.simulate.policy import Observations, Padded, Policy
from acgd.students.acting import Actor, Memory
from acgd.students.settings import ActingConfig
from acgd.students.student import META, Student
from acgd.vision.backbones import load as load_backbone


@dataclass(frozen=True)
class LoadedPolicy:
    """A policy, and the tasks that it has learned."""

    policy: Policy
    tasks: Sequence[str]
    """Names; a task's place is its id."""

    def start(self, tasks: np.ndarray, goals: np.ndarray | None, seeds: list[int]) -> Any:
        return self.policy.start(tasks, goals, seeds)

    def act(self, observations: Observations, memory: Any) -> tuple[np.ndarray, Any]:
        return self.policy.act(observations, memory)


@dataclass(frozen=True)
class ActorPolicy:
    """An Actor under the names of the policy interface."""

    actor: Actor

    def start(self, tasks: np.ndarray, goals: np.ndarray | None, seeds: list[int]) -> Memory:
        return self.actor.reset(tasks, goals, seeds)

    def act(self, observations: Observations, memory: Memory) -> tuple[np.ndarray, Memory]:
        return self.actor.act(observations, memory)


def load_policy(
    student_dir: Path,
    backbone_dir: Path,
    acting: ActingConfig,
    device: torch.device,
    rows: int,
    weights: str = "best",
) -> LoadedPolicy:
    """The student of a `student` artifact, ready to act. rows: episodes at most, and the rows of every computation.

    weights: best or last. `backbone_dir` is not read for a student that owns its CNN.
    """
    student = Student.load(student_dir, weights, device)
    backbone = None if student.sizes.owns_cnn else load_backbone(backbone_dir, device)
    tasks = json.loads((Path(student_dir) / META).read_text())["tasks"]
    return LoadedPolicy(Padded(ActorPolicy(Actor(student, backbone, acting)), rows), tuple(tasks))
