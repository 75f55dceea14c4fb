"""MuJoCo's import, with every value of MUJOCO_GL: all files of this package import MuJoCo from here.

`import mujoco` also loads the OpenGL backend that MUJOCO_GL names, and fails where that backend is unknown or not
installed. Experts and critics draw nothing. This file therefore imports MuJoCo without OpenGL where the import with
OpenGL fails. A picture then raises the error of acgd/tasks/rendering/gl.py.
"""

import os

SETTINGS = ("MUJOCO_GL", "PYOPENGL_PLATFORM")
"""Environment variables that the import of a backend reads or sets."""

_before = {name: os.environ.get(name) for name in SETTINGS}
try:
    import mujoco
except (AttributeError, ImportError, OSError, RuntimeError, TypeError):  # PyOpenGL's errors of a missing library
    try:
        os.environ["MUJOCO_GL"] = "disabled"
        import mujoco
    finally:
        for _name, _value in _before.items():
            os.environ.pop(_name, None)
            if _value is not None:
                os.environ[_name] = _value

__all__ = ["mujoco"]
