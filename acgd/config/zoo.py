"""Where the trained experts that come with the product lie."""

from pathlib import Path

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


def files(task: str) -> tuple[Path, ...]:
    """The files of a task's expert, and of its own critics where it has them."""
    return tuple(folder(task) / name for name in FILES) + tuple(path for name in CRITIC if (path := folder(task) / name).is_file())


CRITIC_FOLDER = "critic"
FITTED = ("critic.safetensors", "critic.json", "quality.json", "within_state.csv")


def fitted_critic(task: str) -> tuple[Path, ...]:
    """The files of the critic that was fitted to a task's expert. Raises FileNotFoundError where one is missing."""
    files = tuple(folder(task) / CRITIC_FOLDER / name for name in FITTED)
    missing = [str(path) for path in files if not path.is_file()]
    if missing:
        have = sorted(path.parents[1].name for path in ROOT.glob(f"*/{CRITIC_FOLDER}/{FITTED[0]}"))
        raise FileNotFoundError(f"critic.source is zoo, but there is no {missing[0]}: set it to fqe, or use a task whose critic is there ({', '.join(have)})")
    return files
