"""Students as artifacts: made anew, saved, loaded, and loaded to act."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch
from pydantic import TypeAdapter
from safetensors.torch import load_file, save_file
from torch import Tensor

from acgd.settings import Section, imported
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
    steps, owns_cnn = data.windows.steps, "features" not in inputs
    return Sizes(
        features=_cnn_width(inputs["backbone"]) if owns_cnn else steps["vision"].shape[-1],
        proprio=steps["proprio"].shape[-1],
        actions=steps["label"].shape[-1],
        tasks=len(data.by_task),
        owns_cnn=owns_cnn,
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


def load_policy(
    student_dir: Path,
    backbone_dir: Path,
    acting: ActingConfig,
    device: torch.device,
    rows: int | None = None,
    weights: Literal["best", "last"] = "best",
) -> "StudentPolicy":
    """The student of an artifact and the backbone that it was trained with, ready to act.

    `rows`: every computation has as many rows, so that an episode does not depend on how many others there are.
    """
    student = load_student(student_dir, weights, device)
    backbone = None if student.sizes.owns_cnn else load_backbone(backbone_dir, device)
    tasks = json.loads((Path(student_dir) / META).read_text())["tasks"]
    return StudentPolicy(student, backbone, acting, tasks=tasks, device=device, rows=rows)


class StudentPolicy:
    """A student in the simulator. It passes on `image` and `proprio`, and nothing else: no kind can read the state."""

    def __init__(
        self,
        student: Student,
        backbone: torch.nn.Module | None,
        acting: ActingConfig,
        *,
        tasks: Sequence[str],
        device: torch.device,
        rows: int | None = None,
    ) -> None:
        """`backbone`: (B, H, W, 3) uint8 -> (B, F), None for a student that owns its CNN."""
        self.tasks, self.rows = list(tasks), rows
        """Names of the tasks; a task id is a place in this list."""
        self.uses_goal = student.imitation.goal_image != "off"
        self.policy = student.policy(Perception(backbone, uses_goal=self.uses_goal, device=device), acting)

    def start(self, tasks: np.ndarray, goals: np.ndarray | None, seeds: list[int]) -> Any:
        """tasks (n,) int, goal images (n, H, W, 3) uint8 or None, seeds of the episodes -> memory."""
        goals = None if goals is None else self._padded(goals)
        return self.policy.start(self._padded(np.asarray(tasks)), goals, self._padded(np.asarray(seeds)).tolist())

    def act(self, obs: Mapping[str, np.ndarray], memory: Any) -> tuple[np.ndarray, Any]:
        """image (n, H, W, 3) uint8, proprio (n, P) -> actions (n, A) float32 in the box, and the next memory."""
        seen = {name: self._padded(obs[name]) for name in ("image", "proprio")}
        actions, memory = self.policy.act(seen, memory)
        return actions[: len(obs["image"])], memory

    def _padded(self, array: np.ndarray) -> np.ndarray:
        """(n, ...) -> (rows, ...), the last row repeated."""
        missing = 0 if self.rows is None else self.rows - len(array)
        return np.concatenate([array, np.repeat(array[-1:], missing, axis=0)]) if missing > 0 else array


def _cnn_width(backbone: Path) -> int:
    """`dim` of a backbone of kind `scratch`."""
    return json.loads((Path(backbone) / "backbone.json").read_text())["dim"]
