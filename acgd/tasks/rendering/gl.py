"""Offscreen OpenGL: one context per process, and an error whose mend fits the cause where OpenGL does not work.

MUJOCO_GL names the backend, with MuJoCo's values. The default on Linux is EGL, which needs no display and no GPU. This
file loads the backend at the first picture.

The context is current in a thread only while that thread draws, so that any thread may draw; a lock lets one thread
draw at a time.

Mesa's software renderer distributes a picture over all cores. For small pictures this is slower, by a factor of three
where another process uses the cores. This file therefore sets LP_NUM_THREADS to 0 unless it is set.
"""

import atexit
import contextlib
import ctypes
import functools
import importlib
import os
import sys
import threading
from collections.abc import Iterator

INSTALL = "apt-get install libegl1 libopengl0 libgl1-mesa-dri"
_DEFAULT = ("", "enable", "enabled", "on", "true", "1")
_OFF = ("disable", "disabled", "off", "false", "0")
_BACKENDS = {"egl": "egl", "osmesa": "osmesa", "glfw": "glfw", "glx": "glfw", "wgl": "glfw", "cgl": "cgl"}
"""Value of MUJOCO_GL -> MuJoCo's module."""
_SOFTWARE = ("llvmpipe", "softpipe")
"""Names of Mesa's software renderers."""
_CHOICES = ("MUJOCO_EGL_DEVICE_ID", "__EGL_VENDOR_LIBRARY_FILENAMES", "__EGL_VENDOR_LIBRARY_DIRS")
"""Environment variables that choose an EGL device or driver."""
_GL_RENDERER = 0x1F01

_lock = threading.RLock()
_thread = threading.local()
_context_process = 0
"""Process that created the context; 0 without a context."""
_survives_fork = False
"""Whether a fork may draw with a copy of the context."""


class GraphicsError(RuntimeError):
    """Offscreen OpenGL does not work. The message names the cause and what to install or set."""


def backend() -> str:
    """Name of the OpenGL backend: that of MUJOCO_GL, by default EGL on Linux and a hidden window elsewhere."""
    requested = os.environ.get("MUJOCO_GL", "").lower().strip()
    if requested in _OFF:
        raise GraphicsError(
            explain(f"MUJOCO_GL={requested} turns OpenGL off", "Set MUJOCO_GL=egl or leave it unset to draw images.")
        )
    if requested in _DEFAULT:
        return "egl" if sys.platform.startswith("linux") else "glfw"
    if requested not in _BACKENDS:
        raise GraphicsError(
            explain(
                f"MUJOCO_GL={requested} is no OpenGL backend",
                "Set MUJOCO_GL=egl or leave it unset; osmesa and glfw work where they are installed.",
            )
        )
    return _BACKENDS[requested]


@functools.lru_cache(maxsize=1)
def context():
    """The OpenGL context of the process (such as `mujoco.egl.GLContext`), created at the first call.

    All tasks of a process use this context, with a framebuffer each. `drawing` makes it current.
    """
    global _context_process, _survives_fork
    name = backend()
    platform = os.environ.get("PYOPENGL_PLATFORM", "")
    if name in ("egl", "osmesa") and platform and platform.lower() != name:
        raise GraphicsError(
            explain(
                f"PYOPENGL_PLATFORM={platform} contradicts the OpenGL backend '{name}'",
                f"Unset PYOPENGL_PLATFORM, or set it to {name}.",
            )
        )
    os.environ.setdefault("LP_NUM_THREADS", "0")
    # A missing library is an AttributeError in PyOpenGL, a missing driver an ImportError or an EGLError.
    try:
        gl_context = importlib.import_module(f"mujoco.{name}").GLContext(64, 64)
        if not gl_context._context:
            raise RuntimeError("no context")
        with gl_context.as_current():
            single = os.environ["LP_NUM_THREADS"] == "0"
            _survives_fork = single and (name == "osmesa" or (name == "egl" and _renderer().startswith(_SOFTWARE)))
    except Exception as error:
        if not platform:
            os.environ.pop("PYOPENGL_PLATFORM", None)  # set by MuJoCo's module; another backend must not inherit it
        fault = str(error).strip().rstrip(".").splitlines()
        raise GraphicsError(
            explain(
                f"the OpenGL backend '{name}' does not start ({fault[0] if fault else type(error).__name__})",
                _mend(name),
            )
        ) from error
    _context_process = os.getpid()
    return gl_context


@contextlib.contextmanager
def drawing() -> Iterator[None]:
    """Makes the process's context current in this thread. Other threads wait until the block ends."""
    with _lock:
        if inherited() and not _survives_fork:
            raise GraphicsError(
                explain(
                    "this process was forked after its parent had drawn an image",
                    "Start processes with the method spawn (multiprocessing.get_context('spawn'), context='spawn' of "
                    "AsyncVectorEnv), or fork before the first image.",
                )
            )
        gl_context = context()
        if not getattr(_thread, "prepared", False):
            _thread.prepared = True
            if egl := sys.modules.get("mujoco.egl"):  # EGL calls refer to OpenGL ES in a new thread
                egl.EGL.eglBindAPI(egl.EGL.EGL_OPENGL_API)
        with gl_context.as_current():
            yield


def inherited() -> bool:
    """Whether this process was forked after its parent had created the context."""
    return _context_process not in (0, os.getpid())


def explain(what: str, mend: str) -> str:
    """Message of an error: the fault `what`, and its mend."""
    return f"Cannot draw images: {what}. {mend} Experts and critics need no images and run without."


def _mend(name: str) -> str:
    """Mend of a backend that does not start, from the environment variables that can be its cause."""
    if name == "osmesa":
        return "Install it (on Debian or Ubuntu: apt-get install libosmesa6), or set MUJOCO_GL=egl or leave it unset."
    if name != "egl":
        return "It needs a display. On Linux set MUJOCO_GL=egl or leave it unset, which needs none."
    driver = f"install Mesa's software renderer (on Debian or Ubuntu: {INSTALL})"
    if chosen := [f"{variable}={os.environ[variable]}" for variable in _CHOICES if variable in os.environ]:
        return f"Unset or correct {' and '.join(chosen)}. Without a graphics driver {driver}."
    if "OpenGL.platform" in sys.modules and type(sys.modules["OpenGL.platform"].PLATFORM).__name__ != "EGLPlatform":
        return (
            "Another package has started PyOpenGL with another platform in this process: "
            "set PYOPENGL_PLATFORM=egl before Python starts."
        )
    return f"{driver[0].upper() + driver[1:]}. MUJOCO_GL=osmesa works where libosmesa6 is installed."


def _renderer() -> str:
    """Name of the EGL driver's renderer, such as `llvmpipe (LLVM 15.0.7, 256 bits)`."""
    from mujoco.egl import egl_ext

    address = ctypes.cast(egl_ext.eglGetProcAddress("glGetString"), ctypes.c_void_p).value
    return (ctypes.CFUNCTYPE(ctypes.c_char_p, ctypes.c_uint)(address)(_GL_RENDERER) or b"").decode()


def _start_fork() -> None:
    _lock.release()
    if inherited():
        atexit.register(_leave_fork)


def _leave_fork() -> None:
    """Leaves the inherited context as it is. To free it, the driver would wait for threads that a fork lacks."""
    if egl := sys.modules.get("mujoco.egl"):
        egl.EGL_DISPLAY = None
    context()._context = None


if hasattr(os, "register_at_fork"):  # a fork waits for the picture of another thread, and inherits a free lock
    os.register_at_fork(before=_lock.acquire, after_in_parent=_lock.release, after_in_child=_start_fork)
