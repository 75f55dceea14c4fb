"""Where the trained experts that come with the product lie."""

from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2] / "zoo"
FILES = ("policy.safetensors", "policy.json", "card.json", "curve.csv")
CRITIC = ("critic.safetensors", "critic.json")
"""An off-policy expert's own critics, as the critic stage saves them."""


def folder(task: str, root: Path | None = None) -> Path:
    """`myo/key-turn` -> zoo/myo-key-turn."""
    return (root or ROOT) / task.replace("/", "-")


def missing(task: str) -> list[str]:
    """Files that the zoo lacks for a task; none where it has an expert."""
    return [name for name in FILES if not (folder(task) / name).is_file()]


def has_expert(task: str) -> bool:
    """Whether all of them are there."""
    return not missing(task)


def files(task: str) -> tuple[Path, ...]:
    """The files of a task's expert, and of its own critics where it has them."""
    return tuple(folder(task) / name for name in FILES) + tuple(
        path for name in CRITIC if (path := folder(task) / name).is_file()
    )


CRITIC_FOLDER = "critic"
FITTED = ("critic.safetensors", "critic.json", "quality.json", "within_state.csv")


def fitted_critic(task: str) -> tuple[Path, ...]:
    """The files of the critic that was fitted to a task's expert."""
    return tuple(folder(task) / CRITIC_FOLDER / name for name in FITTED)


def read_by(stage: str, request: Any) -> tuple[Path, ...]:
    """The files that an artifact is made from, besides its inputs: they are part of its key."""
    if stage == "expert":
        task = request.task.name if request.expert.source == "zoo" else request.expert.first_task
        return files(task) if task else ()
    return fitted_critic(request.task.name) if stage == "critic" and request.critic.source == "zoo" else ()


def has_fitted_critic(task: str) -> bool:
    """Whether the zoo has that critic."""
    return all(path.is_file() for path in fitted_critic(task))


def has_own_critics(task: str) -> bool:
    """Whether the zoo has the critics that a task's expert learned itself."""
    return all((folder(task) / name).is_file() for name in CRITIC)
