"""Offscreen OpenGL: one context per process, and an error with its mend where OpenGL is missing.

MUJOCO_GL names the backend (`egl`, `osmesa`, `glfw`), as in MuJoCo. The default on Linux is EGL, which needs no display
and no GPU. This file loads the backend at the first picture. `import mujoco` would fix its choice at import, and would
fall back on a window system.

Mesa's software renderer distributes a picture over all cores. For small pictures this is slower, by a factor of three
where another process uses the cores. This file therefore sets LP_NUM_THREADS to 0 unless it is set.
"""

import functools
import importlib
import os
import sys

INSTALL = "apt-get install libegl1 libopengl0 libgl1-mesa-dri"
_BACKENDS = ("egl", "osmesa", "glfw")


class GraphicsError(RuntimeError):
    """Offscreen OpenGL is missing. The message says what to install or set."""


def backend() -> str:
    """Name of the OpenGL backend: MUJOCO_GL, else EGL on Linux and a hidden window elsewhere."""
    requested = os.environ.get("MUJOCO_GL", "").lower().strip()
    if not requested:
        return "egl" if sys.platform.startswith("linux") else "glfw"
    if requested not in _BACKENDS:
        raise GraphicsError(explain(f"MUJOCO_GL={requested} is no offscreen OpenGL backend"))
    return requested


@functools.lru_cache(maxsize=1)
def context():
    """The OpenGL context of the process (such as `mujoco.egl.GLContext`), created at the first call.

    All tasks of a process use this context, with a framebuffer each. It belongs to the rendering thread.
    """
    name = backend()
    os.environ.setdefault("LP_NUM_THREADS", "0")
    # A missing library is an AttributeError in PyOpenGL, a missing driver an ImportError or an EGLError. All failures
    # have the same mend.
    try:
        gl_context = importlib.import_module(f"mujoco.{name}").GLContext(64, 64)
        gl_context.make_current()
    except Exception as error:
        raise GraphicsError(
            explain(f"the OpenGL backend '{name}' does not start ({str(error).rstrip('.')})")
        ) from error
    return gl_context


def explain(what: str) -> str:
    """Message of an error: the fault `what`, and its mend."""
    return (
        f"Cannot draw images: {what}. On Debian or Ubuntu install Mesa's software renderer "
        f"({INSTALL}) and set MUJOCO_GL=egl or leave it unset; MUJOCO_GL=osmesa works "
        "where libosmesa6 is installed. Experts and critics need no images and run without."
    )
