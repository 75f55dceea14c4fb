"""Definition of a task: digests of its sources, for the keys of its artifacts.

The sources are the file of the task's kind, the file of its environment, and all files in acgd/tasks that these import,
directly or indirectly. Digests are those of syntax trees without comments, docstrings and layout. Files in
acgd/tasks/rendering and a kind's `CAMERA` belong to the digest of pictures, other statements to that of episodes. An
edit of a kind remakes the artifacts of that kind. An edit of its camera remakes only artifacts that depend on pictures.

This file imports no simulator. A digest is the same in every version of Python that can parse the sources.
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
    "simulator.py",
    "rendering/gl.py",
)
"""Files that define no task: names, settings (a stage's request contains them), and the start of MuJoCo and OpenGL."""
RENDERING = "rendering"
CAMERA = "CAMERA"


class Definition(NamedTuple):
    """SHA-256 of the sources that change an episode, and of those that change only a picture."""

    episode: str
    """Model, starts, observations, reward, success, time limit."""
    picture: str
    """Camera, renderer, and the names of the privileged entries of the state."""


def definition(task_name: str) -> Definition:
    """The digests of a task from the current sources. A file of unchanged size and time is read once per process."""
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
    """Sorted source files of a task."""
    spec = TASKS[task_name]
    left_out = {FOLDER / name for name in LEFT_OUT}
    reached: set[Path] = set()
    pending = [_file(spec.module), _file(spec.environment.split(":")[0])]
    while pending:
        file = pending.pop()
        if file and file not in reached and file not in left_out:
            reached.add(file)
            pending += map(_file, _read(file).imports)
    return sorted(reached)


def packages(task_name: str) -> dict[str, str]:
    """Installed versions of the packages that change an episode of the task, from package metadata."""
    return {name: _version(name) for name in ("mujoco", *_PACKAGES[TASKS[task_name].suite])}


def drawing_packages() -> dict[str, str]:
    """Installed versions of the packages that change pictures and no episodes."""
    return {"fast-simplification": _version("fast-simplification")}


_PACKAGES: dict[str, tuple[str, ...]] = {
    "myo": ("myosuite", "myo-sim"),
    "bidex": ("gymnasium-robotics",),
    "opdex": (),
}
"""Suite -> packages other than MuJoCo whose version changes an episode."""


class _Source(NamedTuple):
    """Digests and imports of one file."""

    episode: str
    """Digest of the statements that may change an episode; empty without such statements."""
    picture: str
    """Digest of the statements that change only a picture; empty without such statements."""
    imports: tuple[str, ...]
    """Names in acgd.tasks that the file imports, at module level or in functions."""


def _read(file: Path) -> _Source:
    stat = file.stat()
    return _read_at(file, stat.st_size, stat.st_mtime_ns)


@cache
def _read_at(file: Path, size: int, mtime_ns: int) -> _Source:
    tree = ast.parse(file.read_bytes())
    rendering = file.is_relative_to(FOLDER / RENDERING)
    picture = [statement for statement in tree.body if rendering or _is_picture(statement)]
    episode = [statement for statement in tree.body if statement not in picture]
    return _Source(*(_digest(_text(part)) if part else "" for part in (episode, picture)), tuple(_imports(tree)))


def _is_picture(statement: ast.stmt) -> bool:
    """Whether a statement of a kind's file defines the camera, or imports from acgd.tasks.rendering."""
    if isinstance(statement, ast.Assign | ast.AnnAssign):
        targets = statement.targets if isinstance(statement, ast.Assign) else [statement.target]
        return any(isinstance(target, ast.Name) and target.id == CAMERA for target in targets)
    return isinstance(statement, ast.ImportFrom) and (statement.module or "").startswith(f"{PACKAGE}.{RENDERING}")


def _imports(tree: ast.AST) -> Iterator[str]:
    """Imported names in acgd.tasks. `from a import b` yields both `a` and `a.b`, since `b` may be a module."""
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
    """File of a module of acgd.tasks; None for a name in a module and for a folder."""
    file = FOLDER.joinpath(*module.removeprefix(f"{PACKAGE}.").split(".")).with_suffix(".py")
    return file if file.is_file() else None


def _text(value: object) -> str:
    """Syntax tree as text, without positions and string statements.

    Empty fields are left out, because their set differs between versions of Python.
    """
    if isinstance(value, ast.AST):
        fields = ((name, getattr(value, name, None)) for name in value._fields)
        inner = [f"{name}={_text(item)}" for name, item in fields if item is not None and item != []]
        return f"{type(value).__name__}({','.join(inner)})"
    if isinstance(value, list):
        return f"[{','.join(_text(item) for item in value if not _is_comment(item))}]"
    return repr(value)


def _is_comment(node: object) -> bool:
    """Whether the node is a docstring or a string below a constant."""
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()


@cache
def _version(package: str) -> str:
    return version(package)
