"""Graphics as people set them: tasks without pictures run in every case, and a failing picture names its cause."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

VARIABLES = ("MUJOCO_GL", "PYOPENGL_PLATFORM", "MUJOCO_EGL_DEVICE_ID", "DISPLAY", "WAYLAND_DISPLAY", "LP_NUM_THREADS")
SCRIPT = """
import os, sys
from acgd.tasks import registry
before = {name: os.environ.get(name) for name in ("MUJOCO_GL", "PYOPENGL_PLATFORM")}
env = registry.make("opdex/spray-1", image_size=None)
env.reset(seed=0)
env.step([0.0] * env.model.nu)
print("states without pictures")
print("picture", env.render(32).shape)
"""


def python(script: str, changed: dict[str, str], timeout: float = 60) -> subprocess.CompletedProcess[str]:
    kept = {name: value for name, value in os.environ.items() if name not in VARIABLES}
    command = [sys.executable, "-c", script]
    return subprocess.run(command, env=kept | changed, capture_output=True, text=True, check=False, timeout=timeout)


@pytest.mark.parametrize(
    "changed",
    [
        {"MUJOCO_GL": "EGL"},
        {"MUJOCO_GL": "on", "PYOPENGL_PLATFORM": "egl"},
        {"MUJOCO_EGL_DEVICE_ID": "0", "DISPLAY": ":77", "CUDA_VISIBLE_DEVICES": "9"},
    ],
)
def test_settings_that_name_what_is_there_draw(changed):
    ran = python(SCRIPT, changed)
    assert "picture (32, 32, 3)" in ran.stdout, ran.stderr


@pytest.mark.parametrize(
    ("changed", "mend"),
    [
        ({"MUJOCO_GL": "nonsense"}, "MUJOCO_GL=nonsense is no OpenGL backend. Set MUJOCO_GL=egl"),
        ({"MUJOCO_GL": "off"}, "MUJOCO_GL=off turns OpenGL off. Set MUJOCO_GL=egl"),
        ({"MUJOCO_GL": "glx"}, "It needs a display. On Linux set MUJOCO_GL=egl"),
        ({"PYOPENGL_PLATFORM": "glx"}, "Unset PYOPENGL_PLATFORM, or set it to egl"),
        ({"MUJOCO_GL": "osmesa", "PYOPENGL_PLATFORM": "egl"}, "Unset PYOPENGL_PLATFORM, or set it to osmesa"),
        ({"MUJOCO_EGL_DEVICE_ID": "7"}, "Unset or correct MUJOCO_EGL_DEVICE_ID=7"),
        ({"MUJOCO_EGL_DEVICE_ID": "cuda:0"}, "Unset or correct MUJOCO_EGL_DEVICE_ID=cuda:0"),
    ],
)
def test_without_pictures_nothing_needs_opengl_and_a_picture_names_the_mend(changed, mend):
    ran = python(SCRIPT, changed)
    assert "states without pictures" in ran.stdout, ran.stderr
    error = ran.stderr.strip().splitlines()[-1]
    assert ran.returncode == 1 and "GraphicsError: Cannot draw images" in error and mend in error, error


def test_a_backend_without_its_library_leaves_the_environment_and_names_the_package():
    """MuJoCo's own import fails here: PyOpenGL finds no osmesa."""
    ran = python(SCRIPT.replace('print("picture"', "print(before)\nprint('picture'"), {"MUJOCO_GL": "osmesa"})
    assert "states without pictures" in ran.stdout, ran.stderr
    if "picture (" not in ran.stdout:  # libosmesa6 is not installed
        assert "{'MUJOCO_GL': 'osmesa', 'PYOPENGL_PLATFORM': None}" in ran.stdout
        assert "apt-get install libosmesa6" in ran.stderr.strip().splitlines()[-1]


def test_mujoco_is_imported_in_one_place():
    """Another `import mujoco` would fail where OpenGL is missing."""
    folder = Path(__file__).parents[1] / "acgd"
    files = [
        f for f in folder.rglob("*.py") if re.search(r"^\s*(import mujoco\b|from mujoco import)", f.read_text(), re.M)
    ]
    assert [f.relative_to(folder).as_posix() for f in files] == ["tasks/simulator.py"]


FORK = """
import multiprocessing, os, sys
from acgd.tasks import registry
from acgd.tasks.rendering import gl
env = registry.make("opdex/spray-1", image_size=32)
first = env.reset(seed=0)[0]["image"]

def draw(queue):
    try:
        queue.put(bool((env.reset(seed=0)[0]["image"] == first).all()))
    except gl.GraphicsError as error:
        queue.put(str(error))

queue = multiprocessing.get_context("fork").Queue()
process = multiprocessing.get_context("fork").Process(target=draw, args=(queue,))
process.start()
print(queue.get(timeout=20))
process.join(20)
print("exit", process.exitcode)
child = os.fork()
if not child:
    sys.exit(3)
print("exit", os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))
print("parent", bool((env.reset(seed=0)[0]["image"] == first).all()))
"""


@pytest.mark.parametrize("threads", ["0", "2"])
def test_a_fork_after_a_picture_draws_the_same_or_is_refused(threads):
    """Software that draws without threads survives a fork; a driver with threads or hardware does not."""
    lines = python(FORK, {"LP_NUM_THREADS": threads}).stdout.splitlines()
    assert lines[1:] == ["exit 0", "exit 3", "parent True"]
    assert lines[0] == "True" or ("forked after its parent had drawn" in lines[0] and "spawn" in lines[0])
    assert threads == "0" or lines[0] != "True"
