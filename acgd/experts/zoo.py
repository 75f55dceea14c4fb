"""Paths of the trained experts in zoo/ and of their critics."""

from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

from acgd.tasks.spec import TASKS

_PACKAGE = Path(__file__).resolve().parents[1]
ROOT = _PACKAGE / "zoo" if (_PACKAGE / "zoo").is_dir() else _PACKAGE.parent / "zoo"
"""Part of an installed package; in a clone it lies beside the package."""
POLICY = ("policy.safetensors", "policy.json")
CRITIC = ("critic.safetensors", "critic.json")
"""Files of a critic. The critics of an off-policy learner lie beside the policy. The critic that was fitted to the
frozen expert lies in CRITIC_FOLDER."""
CARD = ("card.json", "curve.csv")
FILES = POLICY + CARD
CRITIC_FOLDER = "critic"


def folder(task: str) -> Path:
    """Folder of a task's expert: `myo/key-turn` -> zoo/myo-key-turn."""
    return ROOT / task.replace("/", "-")


def policy_files(task: str) -> tuple[Path, ...]:
    """The policy, and the critics that were trained with it, if any."""
    critics = CRITIC if has_learned_critics(task) else ()
    return tuple(folder(task) / name for name in POLICY + critics)


def card_files(task: str) -> tuple[Path, ...]:
    """Card and learning curve."""
    return tuple(folder(task) / name for name in CARD)


def fitted_critic(task: str) -> tuple[Path, ...]:
    """Files of the critic that was fitted to a task's frozen expert."""
    return tuple(folder(task) / CRITIC_FOLDER / name for name in CRITIC)


def missing(task: str) -> list[str]:
    """Names of the expert's files that the zoo lacks; empty where the zoo has the expert."""
    return [name for name in FILES if not (folder(task) / name).is_file()]


def has_expert(task: str) -> bool:
    """Whether the zoo has an expert for a task."""
    return not missing(task)


def has_learned_critics(task: str) -> bool:
    """Whether the zoo has critics that were trained with the expert's policy."""
    return all((folder(task) / name).is_file() for name in CRITIC)


def has_fitted_critic(task: str) -> bool:
    """Whether the zoo has a critic that was fitted to the frozen expert."""
    return all(path.is_file() for path in fitted_critic(task))


def tasks_with(condition: Callable[[str], bool]) -> str:
    """Names of the tasks for which `condition` holds, for messages."""
    return ", ".join(filter(condition, TASKS)) or "none yet"


def faults(tasks: Iterable[tuple[str, Any, Any]]) -> Iterator[str]:
    """Messages on faults of (task, expert settings, critic settings), each with its mend."""
    for task, expert, critic in tasks:
        yield from expert.faults(task)
        yield from critic.faults(task, expert)
