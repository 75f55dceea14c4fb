"""Students as artifacts: made anew, saved, loaded, and loaded to act."""

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
    """What the data dictate. Without features the student owns a CNN as wide as the backbone's settings say."""
    steps, owns_cnn, imitation = data.windows.steps, "features" not in inputs, data.imitation
    if owns_cnn and imitation.frames > 1:
        raise ValueError(
            f"imitation.frames is {imitation.frames}, but a student that trains its own CNN (backbone.kind: scratch) "
            "reads one image: set imitation.frames to 1, or take another backbone"
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
    """A student of the kind that `settings` name, its weights drawn from torch's global generator."""
    return imported(STUDENTS[settings.kind].code)(settings, imitation, sizes)


def save_student(
    student: Student, directory: Path, weights: Mapping[str, dict[str, Tensor]], notes: Mapping[str, Any]
) -> None:
    """`weights`: name -> state dict, each its own file; kind, settings, sizes and `notes` as JSON."""
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
    """The student of an artifact, in evaluation mode. best: of least error on the validation episodes."""
    meta = json.loads((Path(directory) / META).read_text())
    settings = TypeAdapter(StudentConfig).validate_python(meta["student"])
    student = new_student(settings, ImitationConfig(**meta["imitation"]), Sizes(**meta["sizes"]))
    student.load_state_dict(load_file(Path(directory) / f"{weights}.safetensors"))
    return student.to(device).eval()


@dataclass(frozen=True)
class StudentPolicy:
    """A student in the simulator, by the interface of acgd.simulate.policy. No kind can read the privileged state."""

    policy: Policy
    tasks: list[str]
    """Names; a task's place is its id."""
    goal: str
    """What it is given at the start, as `imitation.goal` says."""

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
    """The student of an artifact and the backbone that it was trained with, ready to act.

    rows: episodes at most, and the rows of every computation.
    """
    student = load_student(student_dir, weights, device)
    backbone = None if student.sizes.owns_cnn else load_backbone(backbone_dir, device)
    tasks = json.loads((Path(student_dir) / META).read_text())["tasks"]
    return policy_of(student, backbone, acting, tasks=tasks, rows=rows)


def policy_of(
    student: Student, backbone: nn.Module | None, acting: ActingConfig, *, tasks: Sequence[str], rows: int
) -> StudentPolicy:
    """A student ready to act. `backbone`: (B, H, W, 3) uint8 -> (B, F), None for a student that owns its CNN."""
    device = next(student.parameters()).device
    policy = Perception(student.policy(acting), backbone, student.imitation, student.sizes, device)
    return StudentPolicy(Restricted(Padded(policy, rows), STUDENT_ENTRIES), list(tasks), student.imitation.goal)


def _cnn_width(backbone: Path) -> int:
    """`dim` of a backbone of kind `scratch`."""
    return json.loads((Path(backbone) / "backbone.json").read_text())["dim"]
