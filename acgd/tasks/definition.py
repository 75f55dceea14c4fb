"""What defines a task: digests of its sources, for the keys of the artifacts that are made by it.

A task is defined by the file of its kind, the file of its environment, and every file in acgd/tasks that these import,
directly or through others. What they say counts, and not how it is written: comments, docstrings and
layout are left out.
Files in acgd/tasks/rendering, and the kind's `CAMERA`, change a picture; the others change an episode.

So an edit of a kind remakes the artifacts of that kind, and an edit of its camera only what was made from pictures.
Nothing here imports a simulator, and a digest is the same under every version of Python that can read the sources.
"""

import ast
import hashlib
from collections.abc import Iterator
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import NamedTuple

from acgd.tasks.spec import TASKS

FOLDER = Path(__file__).parent
PACKAGE = "acgd.tasks"
LEFT_OUT = (
    "__init__.py",
    "spec.py",
    "settings.py",
    "registry.py",
    "gymnasium_ids.py",
    "definition.py",
    "rendering/gl.py",
)
"""Names, settings (a stage's request holds them), and how OpenGL is started: they define no task."""
RENDERING = "rendering"
CAMERA = "CAMERA"


class Definition(NamedTuple):
    """SHA-256 of what changes an episode, and of what changes only a picture."""

    episode: str
    """Model, starts, observations, reward, success, time limit."""
    picture: str
    """Camera, renderer, and which entries of the state vision has to find out."""


def definition(task_name: str) -> Definition:
    """The digests of a task, from the sources as they are on the disk now. Files that look untouched are read once."""
    spec = TASKS[task_name]
    episode = [repr((spec.name, spec.suite, spec.kind, spec.gym_id, spec.horizon))]
    picture = [repr(spec.privileged)]
    for file in sources(task_name):
        source = _read(file)
        name = file.relative_to(FOLDER).as_posix()
        if source.picture:
            picture.append(f"{name} {source.picture}")
        if source.episode:
            episode.append(f"{name} {source.episode}")
    return Definition(_digest("\n".join(episode)), _digest("\n".join(picture)))


def sources(task_name: str) -> list[Path]:
    """The files that define a task, sorted."""
    spec = TASKS[task_name]
    left_out = {FOLDER / name for name in LEFT_OUT}
    reached: set[Path] = set()
    waiting = [_file(spec.module), _file(spec.environment.split(":")[0])]
    while waiting:
        file = waiting.pop()
        if file and file not in reached and file not in left_out:
            reached.add(file)
            waiting += map(_file, _read(file).imports)
    return sorted(reached)


def packages(task_name: str) -> dict[str, str]:
    """Installed versions of the packages that change an episode of the task. Reads their metadata, imports nothing."""
    return {name: _version(name) for name in ("mujoco", *_PACKAGES[TASKS[task_name].suite])}


def drawing_packages() -> dict[str, str]:
    """Installed versions of the packages that change a picture, besides those that change an episode."""
    return {"fast-simplification": _version("fast-simplification")}


_PACKAGES: dict[str, tuple[str, ...]] = {
    "myo": ("myosuite", "myo-sim"),
    "bidex": ("gymnasium-robotics",),
    "opdex": (),
}
"""Suite -> packages whose version changes an episode, besides MuJoCo."""


class _Source(NamedTuple):
    """One file."""

    episode: str
    """Digest of the statements that may change an episode; empty where there are none."""
    picture: str
    """Digest of the statements that only change a picture; empty where there are none."""
    imports: tuple[str, ...]
    """Modules of acgd.tasks that it may import, functions' imports included."""


def _read(file: Path) -> _Source:
    stat = file.stat()
    return _read_at(file, stat.st_size, stat.st_mtime_ns)


@cache
def _read_at(file: Path, size: int, mtime_ns: int) -> _Source:
    tree = ast.parse(file.read_bytes())
    rendering = file.is_relative_to(FOLDER / RENDERING)
    drawn = [statement for statement in tree.body if rendering or _is_drawn(statement)]
    others = [statement for statement in tree.body if statement not in drawn]
    return _Source(*(_digest(_text(part)) if part else "" for part in (others, drawn)), tuple(_imports(tree)))


def _is_drawn(statement: ast.stmt) -> bool:
    """Whether a statement of a kind's file gives the camera, or imports what the camera is made by."""
    if isinstance(statement, ast.Assign | ast.AnnAssign):
        targets = statement.targets if isinstance(statement, ast.Assign) else [statement.target]
        return any(isinstance(target, ast.Name) and target.id == CAMERA for target in targets)
    return isinstance(statement, ast.ImportFrom) and (statement.module or "").startswith(f"{PACKAGE}.{RENDERING}")


def _imports(tree: ast.AST) -> Iterator[str]:
    """`from acgd.tasks import starts` may name a module or a name in a module: both are given."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            if node.level:
                raise ValueError(f"line {node.lineno}: files in acgd/tasks import each other by full names")
            names = [node.module, *(f"{node.module}.{alias.name}" for alias in node.names)]
        else:
            continue
        yield from (name for name in names if name.startswith(f"{PACKAGE}."))


def _file(module: str) -> Path | None:
    """The file of a module of acgd.tasks; None for a name in a module, and for a folder."""
    file = FOLDER.joinpath(*module.removeprefix(f"{PACKAGE}.").split(".")).with_suffix(".py")
    return file if file.is_file() else None


def _text(value: object) -> str:
    """Syntax as text, without places and string statements. Empty fields are left out: which there are differs between
    versions of Python."""
    if isinstance(value, ast.AST):
        fields = ((name, getattr(value, name, None)) for name in value._fields)
        inner = [f"{name}={_text(item)}" for name, item in fields if item is not None and item != []]
        return f"{type(value).__name__}({','.join(inner)})"
    if isinstance(value, list):
        return f"[{','.join(_text(item) for item in value if not _is_comment(item))}]"
    return repr(value)


def _is_comment(node: object) -> bool:
    """A docstring, or a string below a constant."""
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()


@cache
def _version(package: str) -> str:
    return version(package)
