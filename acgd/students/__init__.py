"""Students: the action codebook, the policy distilled with it, and acting by its chunks."""

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import torch

    from acgd.students.student import Student


def load(artifact_dir: Path, weights: str = "best", device: "torch.device | str" = "cpu") -> "Student":
    """The student of a `student` artifact, ready to act; weights: best or last."""
    from acgd.students.student import Student

    return Student.load(artifact_dir, weights, device)
