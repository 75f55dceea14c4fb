"""Offscreen OpenGL: one context per process, and a clear word when there is none.

The backend is MUJOCO_GL (`egl`, `osmesa`, `glfw`), as everywhere in MuJoCo; unset, it is EGL on Linux, which
needs neither a display nor a GPU. The backend is loaded here, at the first picture, and not by `import mujoco`,
which fixes its own choice at import and falls back on a window system.

Mesa's software renderer shares a picture out over all cores; for small pictures that costs more than it gains
(three times more where another process keeps the cores busy), so LP_NUM_THREADS is 0 here unless it is set.
"""

import functools
import importlib
import os
import sys

INSTALL = "apt-get install libegl1 libopengl0 libgl1-mesa-dri"
_BACKENDS = ("egl", "osmesa", "glfw")


class GraphicsError(RuntimeError):
    """No offscreen OpenGL; the message says what to install or set."""


def backend() -> str:
    """The OpenGL backend to use: MUJOCO_GL, else EGL on Linux and a hidden window elsewhere."""
    wanted = os.environ.get("MUJOCO_GL", "").lower().strip()
    if not wanted:
        return "egl" if sys.platform.startswith("linux") else "glfw"
    if wanted not in _BACKENDS:
        raise GraphicsError(explain(f"MUJOCO_GL={wanted} is no offscreen OpenGL backend"))
    return wanted


@functools.lru_cache(maxsize=1)
def context():
    """The process's one OpenGL context (`mujoco.egl.GLContext` or its like), made on first use.

    All tasks of a process draw in it, each into its own framebuffer. It belongs to the thread that draws.
    """
    name = backend()
    os.environ.setdefault("LP_NUM_THREADS", "0")
    # Backends fail in many ways: a missing library is an AttributeError deep in PyOpenGL, a missing driver an
    # ImportError or an EGLError. Whatever it was, the mend is the same.
    try:
        made = importlib.import_module(f"mujoco.{name}").GLContext(64, 64)
        made.make_current()
    except Exception as error:
        raise GraphicsError(
            explain(f"the OpenGL backend '{name}' does not start ({str(error).rstrip('.')})")
        ) from error
    return made


def explain(what: str) -> str:
    """What is wrong, and what to do about it."""
    return (
        f"Cannot draw images: {what}. On Debian or Ubuntu install Mesa's software renderer "
        f"({INSTALL}) and set MUJOCO_GL=egl or leave it unset; MUJOCO_GL=osmesa works "
        "where libosmesa6 is installed. Experts and critics need no images and run without."
    )
