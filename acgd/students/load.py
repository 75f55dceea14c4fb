"""Makes, saves and loads students, and loads them as policies."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch
from pydantic import TypeAdapter
from safetensors.torch import load_file, save_file
from torch import Tensor, nn

from acgd.settings import Section, imported
from acgd.simulate.policy import STUDENT_ENTRIES, Observations, Padded, Policy, Restricted
from acgd.store.key import in_key
from acgd.store.stage import Inputs
from acgd.students.data import Data
from acgd.students.kinds import STUDENTS
from acgd.students.perception import Perception
from acgd.students.settings import ActingConfig, ImitationConfig, StudentConfig
from acgd.students.student import Sizes, Student
from acgd.vision.backbones import load as load_backbone

META = "student.json"


def sizes_of(data: Data, inputs: Inputs) -> Sizes:
    """Sizes of the data. Without features the student has a CNN, whose width is in the backbone's artifact."""
    steps, owns_cnn, imitation = data.windows.steps, "features" not in inputs, data.imitation
    if owns_cnn and imitation.frames > 1:
        raise ValueError(
            f"imitation.frames is {imitation.frames}, but a student that trains its own CNN (backbone.kind: scratch) "
            "reads one image. Set imitation.frames to 1, or take another backbone."
        )
    return Sizes(
        features=_cnn_width(inputs["backbone"]) if owns_cnn else steps["vision"].shape[-1],
        proprio=steps["proprio"].shape[-1],
        actions=steps["label"].shape[-1],
        tasks=len(data.by_task),
        owns_cnn=owns_cnn,
        goal=data.windows.episodes["goal"].shape[-1] if imitation.goal == "vector" else 0,
    )


def new_student(settings: Section, imitation: ImitationConfig, sizes: Sizes) -> Student:
    """A new student of the settings' kind. Its weights are drawn from torch's global generator."""
    return imported(STUDENTS[settings.kind].code)(settings, imitation, sizes)


def save_student(
    student: Student, directory: Path, weights: Mapping[str, dict[str, Tensor]], notes: Mapping[str, Any]
) -> None:
    """Writes one safetensors file per entry of `weights` (name -> state dict), and student.json.

    student.json holds kind, settings, sizes and `notes`.
    """
    for name, tensors in weights.items():
        save_file({key: value.contiguous() for key, value in tensors.items()}, directory / f"{name}.safetensors")
    meta = {
        "kind": student.settings.kind,
        "student": in_key(student.settings),
        "imitation": in_key(student.imitation),
        "sizes": asdict(student.sizes),
        **notes,
    }
    (directory / META).write_text(json.dumps(meta, indent=1, sort_keys=True) + "\n")


def load_student(directory: Path, weights: Literal["best", "last"], device: torch.device) -> Student:
    """Loads the student of an artifact in evaluation mode. best: the weights of least PLAN_ERROR in validation."""
    meta = json.loads((Path(directory) / META).read_text())
    settings = TypeAdapter(StudentConfig).validate_python(meta["student"])
    student = new_student(settings, ImitationConfig(**meta["imitation"]), Sizes(**meta["sizes"]))
    student.load_state_dict(load_file(Path(directory) / f"{weights}.safetensors"))
    return student.to(device).eval()


@dataclass(frozen=True)
class StudentPolicy:
    """A student with the policy interface of acgd.simulate.policy. It cannot read the privileged state."""

    policy: Policy
    tasks: list[str]
    """Task names. The index of a task is its id."""
    goal: str
    """Setting `imitation.goal`: which goals `start` needs."""

    def start(self, tasks: np.ndarray, goals: np.ndarray | None, seeds: list[int]) -> Any:
        return self.policy.start(tasks, goals, seeds)

    def act(self, observations: Observations, memory: Any) -> tuple[np.ndarray, Any]:
        return self.policy.act(observations, memory)


def load_policy(
    student_dir: Path,
    backbone_dir: Path,
    acting: ActingConfig,
    device: torch.device,
    rows: int,
    weights: Literal["best", "last"] = "best",
) -> StudentPolicy:
    """Loads a student and its backbone as a policy.

    rows: greatest number of episodes in lockstep, and the number of rows of every computation.
    """
    student = load_student(student_dir, weights, device)
    backbone = None if student.sizes.owns_cnn else load_backbone(backbone_dir, device)
    tasks = json.loads((Path(student_dir) / META).read_text())["tasks"]
    return policy_of(student, backbone, acting, tasks=tasks, rows=rows)


def policy_of(
    student: Student, backbone: nn.Module | None, acting: ActingConfig, *, tasks: Sequence[str], rows: int
) -> StudentPolicy:
    """A student as a policy. backbone: (B, H, W, 3) uint8 -> (B, F); None for a student with a CNN."""
    device = next(student.parameters()).device
    policy = Perception(student.policy(acting), backbone, student.imitation, student.sizes, device)
    return StudentPolicy(Restricted(Padded(policy, rows), STUDENT_ENTRIES), list(tasks), student.imitation.goal)


def _cnn_width(backbone: Path) -> int:
    """Width of the student's CNN: `dim` of a backbone of kind `scratch`."""
    return json.loads((Path(backbone) / "backbone.json").read_text())["dim"]
