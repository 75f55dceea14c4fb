"""An edit of the sources changes the digests of the tasks that it changes, and of no others."""

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from acgd.tasks.definition import FOLDER, LEFT_OUT, definition, drawing_packages, packages, sources
from acgd.tasks.spec import TASKS

ROOT = Path(__file__).parents[1]
ALL = set(TASKS)
MYO, BIDEX, OPDEX = ({name for name in TASKS if name.startswith(suite)} for suite in ("myo/", "bidex/", "opdex/"))
KEY = {"myo/key-turn", "myo/key-turn-hard"}


def run(code: str, folder: Path) -> str:
    environment = {**os.environ, "PYTHONPATH": str(folder)}
    command = [sys.executable, "-c", code]
    return subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=True).stdout


def definitions(folder: Path) -> dict[str, list[str]]:
    """Every task's digests, by a process that imports the package in `folder`."""
    code = (
        "import json; from acgd.tasks.definition import definition; from acgd.tasks.spec import TASKS;"
        "print(json.dumps({name: definition(name) for name in TASKS}))"
    )
    return json.loads(run(code, folder))


@pytest.fixture
def copy(tmp_path: Path) -> Path:
    """The sources of the tasks, to be edited."""
    (tmp_path / "acgd").mkdir()
    shutil.copy(FOLDER.parent / "__init__.py", tmp_path / "acgd")
    shutil.copytree(FOLDER, tmp_path / "acgd/tasks", ignore=shutil.ignore_patterns("__pycache__"))
    return tmp_path


def edit(copy: Path, file: str, pattern: str, replacement: str) -> None:
    path = copy / "acgd/tasks" / file
    text, count = re.subn(pattern, replacement, path.read_text(encoding="utf-8"), count=1, flags=re.MULTILINE)
    assert count == 1, f"{pattern} is not in {file}"
    path.write_text(text, encoding="utf-8")


NONE: set[str] = set()
FIXED = '"myoHandKeyTurnFixed-v0",\n        '
NEW = '_SPECS = (TaskSpec("myo/new", "myo", "{}", "x-v0", 9, (), ""),'
EDITS = {
    "key place": ("kinds/key_turn.py", r"KEY_PLACE = 0\.002", "KEY_PLACE = 0.02", KEY, NONE),
    "key angle": ("kinds/key_turn.py", r"KEY_ANGLE = 0\.2", "KEY_ANGLE = 0.3", KEY, NONE),
    "an entry of the state": ("kinds/key_turn.py", r"data\.qvel\[-1:\] \* step", "data.qvel[-1:]", KEY, NONE),
    "noise of the hand": ("kinds/key_turn.py", r"hand_std=0\.03", "hand_std=0.04", KEY, NONE),
    "camera": ("kinds/key_turn.py", r"0\.29, 100\.0", "0.39, 100.0", NONE, KEY),
    "comment": ("kinds/key_turn.py", r"# the Random task", "# that task", NONE, NONE),
    "docstring": ("kinds/key_turn.py", r'\A"""Key-turn:', '"""Key:', NONE, NONE),
    "string below a constant": (
        "kinds/key_turn.py",
        r'^"""Uniform noise of the key.s angle, rad\."""',
        '"""Radians."""',
        NONE,
        NONE,
    ),
    "layout": ("kinds/key_turn.py", r"uniform\(-KEY_ANGLE, ", "uniform(\n        -KEY_ANGLE,\n        ", NONE, NONE),
    "another kind": ("kinds/reach.py", r"0\.015", "0.15", {"myo/reach", "myo/reach-hard"}, NONE),
    "a bottle": ("kinds/spray_1.py", r"0\.036, 0\.036", "0.037, 0.037", {"opdex/spray-1"}, NONE),
    "a scene": ("kinds/switch.py", r"^OFF = 0\.5585", "OFF = 0.6", {"bidex/switch"}, NONE),
    "a shared scene": ("spray.py", r"^HOLD_STEPS = 10", "HOLD_STEPS = 11", OPDEX, NONE),
    "the Shadow Hand": ("robots/shadow.py", r"START_NOISE = 0\.015", "START_NOISE = 0.025", BIDEX, NONE),
    "MyoDex": ("myodex.py", r"^FAR = 100", "FAR = 200", MYO, NONE),
    "success": ("success.py", r"HELD_STEPS = 5", "HELD_STEPS = 6", ALL, NONE),
    "renderer": ("rendering/renderer.py", r"FACES_PER_MESH = 64", "FACES_PER_MESH = 32", NONE, ALL),
    "meshes": ("rendering/meshes.py", r"1e-12", "1e-11", NONE, ALL),
    "start of OpenGL": ("rendering/gl.py", r"GLContext\(64, 64\)", "GLContext(32, 32)", NONE, NONE),
    "time limit": ("spec.py", FIXED + "200", FIXED + "201", {"myo/key-turn"}, NONE),
    "name in MyoSuite": ("spec.py", r"ReachRandom-v0", "ReachRandom-v1", {"myo/reach-hard"}, NONE),
    "privileged entries": ("spec.py", r'_KEY = \("key_qpos", ', "_KEY = (", NONE, KEY),
    "goal text": ("spec.py", r"turn the key past 2 pi", "turn the key past two pi", NONE, NONE),
    "a new task": ("spec.py", r"^_SPECS = \(", NEW.format("reach"), {"myo/new"}, {"myo/new"}),
}
"""Edit -> file, pattern, replacement, tasks of another episode, tasks of another picture."""


@pytest.mark.parametrize("name", EDITS)
def test_an_edit_changes_only_the_digests_that_it_affects(copy: Path, name: str) -> None:
    file, pattern, replacement, *expected = EDITS[name]
    edit(copy, file, pattern, replacement)
    before, after = {task: definition(task) for task in TASKS}, definitions(copy)
    for part, tasks in enumerate(expected):
        assert {task for task in after if task not in before or after[task][part] != before[task][part]} == tasks


def test_a_new_kind_in_a_file_of_its_own_changes_no_other(copy: Path) -> None:
    shutil.copy(copy / "acgd/tasks/kinds/reach.py", copy / "acgd/tasks/kinds/die_turn.py")
    edit(copy, "spec.py", r"^_SPECS = \(", NEW.format("die-turn"))
    after = definitions(copy)
    assert after.pop("myo/new") and after == {task: list(definition(task)) for task in TASKS}


def test_an_edit_is_seen_by_a_running_process(copy: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("acgd.tasks.definition.FOLDER", copy / "acgd/tasks")
    before = definition("myo/reach")
    edit(copy, "kinds/reach.py", r"0\.015", "0.025")
    assert definition("myo/reach").episode != before.episode


def test_tasks_differ_in_their_episode_and_kinds_in_their_picture() -> None:
    digests = {name: definition(name) for name in TASKS}
    assert len({one.episode for one in digests.values()}) == len(TASKS)
    assert len({one.picture for one in digests.values()}) == len({spec.kind for spec in TASKS.values()})


@pytest.mark.parametrize("name", ["myo/key-turn", "myo/pen-twirl-hard", "bidex/bottle", "opdex/spray-2"])
def test_every_source_that_an_episode_loads_defines_the_task(name: str) -> None:
    code = (
        "import sys; from acgd.tasks import registry\n"
        f"env = registry.make({name!r}); obs, _ = env.reset(seed=0); env.step(env.action_space.sample())\n"
        "print('', *(getattr(m, '__file__', '') for n, m in sys.modules.items() if n.startswith('acgd')), sep='\\n')"
    )
    loaded = {Path(line) for line in run(code, ROOT).splitlines() if line.endswith(".py") and Path(line).stat().st_size}
    names = {FOLDER / file for file in LEFT_OUT} | {FOLDER.parent / "settings.py", FOLDER.parent / "__init__.py"}
    assert len(loaded) > 8 and loaded - names == set(sources(name))


def test_a_task_definition_is_fast_and_loads_no_simulator() -> None:
    code = (
        "import sys, time; from acgd.tasks.definition import definition; from acgd.tasks.spec import TASKS\n"
        "began = time.process_time(); [definition(name) for name in list(TASKS)[:10]]\n"
        "print(time.process_time() - began, *sys.modules)"
    )
    seconds, *modules = run(code, ROOT).split()
    assert float(seconds) < 0.05
    assert not {"mujoco", "gymnasium", "numpy", "torch", "pydantic"} & set(modules)


def test_packages_are_those_of_the_suite() -> None:
    assert set(packages("myo/reach")) == {"mujoco", "myosuite", "myo-sim"}
    assert set(packages("bidex/switch")) == {"mujoco", "gymnasium-robotics"}
    assert set(packages("opdex/spray-1")) == {"mujoco"}
    assert set(drawing_packages()) == {"fast-simplification"}
