"""Frugal offscreen pictures of a simulation: about a thousandth of the triangles' cost, none of its physics.

MuJoCo's defaults take 120-370 ms for an 84 px picture of these models on a software renderer. Nearly all of
it is vertices nobody can see (178,021 faces of bones, room and logo), multisampling, shadows and tendons. Here
the physics model and data are read as they are, so that whatever a reset wrote into the model shows; but the meshes
that the graphics card holds come from a copy of the model in which they were decimated.
"""

import atexit
import hashlib

import mujoco
import numpy as np

from acgd.tasks import gl
from acgd.tasks.cameras import Camera
from acgd.tasks.meshes import decimated

FACES_PER_MESH = 128
"""At 84 px a bone covers a few dozen pixels; more faces than that do not show."""
_SHOWN = 0
"""The group of bones, objects and goal markers; rooms, wrapping surfaces, skins and muscle sites are in others."""
_CATEGORIES = mujoco.mjtCatBit.mjCAT_STATIC | mujoco.mjtCatBit.mjCAT_DYNAMIC
_LIGHT = {"dir": (0.3, 0.45, -0.84), "ambient": (0.35,) * 3, "diffuse": (0.65,) * 3, "specular": (0.15,) * 3}
"""One sun for all tasks: the models disagree on lamps, and each lamp costs."""


class Renderer:
    """Draws a simulation. Several of one process share the OpenGL context, and the meshes if they are equal."""

    def __init__(self, model: mujoco.MjModel, *, camera: Camera, size: int = 84) -> None:
        self.size = size
        self._model = model
        self._camera = camera.build()
        self._viewport = mujoco.MjrRect(0, 0, size, size)
        self._buffer = np.empty((size, size, 3), np.uint8)
        self._option = _options()
        self._scene = mujoco.MjvScene(model, maxgeom=model.ngeom + model.nsite)
        self._scene.flags[:] = 0
        self._scene.flags[mujoco.mjtRndFlag.mjRND_CULL_FACE] = 1
        self._target = _target(model, size)

    def render(self, data: mujoco.MjData) -> np.ndarray:
        """The picture (size, size, 3) uint8 of `data`, which is only read; its kinematics must be up to date."""
        scene = self._scene
        mujoco.mjv_updateScene(self._model, data, self._option, None, self._camera, _CATEGORIES, scene)
        _light(scene)
        with gl.context().as_current():
            mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self._target)
            mujoco.mjr_render(self._viewport, scene, self._target)
            mujoco.mjr_readPixels(self._buffer, None, self._viewport, self._target)
        return self._buffer[::-1].copy()  # OpenGL's first row is the lowest


def _options() -> mujoco.MjvOption:
    option = mujoco.MjvOption()
    option.flags[:] = 0
    option.flags[mujoco.mjtVisFlag.mjVIS_STATIC] = 1
    for groups in (option.geomgroup, option.sitegroup):
        groups[:] = 0
        groups[_SHOWN] = 1
    return option


def _light(scene: mujoco.MjvScene) -> None:
    scene.nlight = 1
    light = scene.lights[0]
    light.headlight, light.castshadow = 0, 0
    light.type = mujoco.mjtLightType.mjLIGHT_DIRECTIONAL
    light.dir, light.ambient = _LIGHT["dir"], _LIGHT["ambient"]
    light.diffuse, light.specular = _LIGHT["diffuse"], _LIGHT["specular"]


_TARGETS: dict[tuple[str, int], mujoco.MjrContext] = {}
"""Framebuffer and meshes by content of the meshes and size: tasks on the same hand share one."""


def _target(model: mujoco.MjModel, size: int) -> mujoco.MjrContext:
    drawn = {
        int(mesh)
        for mesh, kind, group in zip(model.geom_dataid, model.geom_type, model.geom_group)
        if kind == mujoco.mjtGeom.mjGEOM_MESH and group == _SHOWN
    }
    content = hashlib.sha256(repr(sorted(drawn)).encode())
    content.update(model.mesh_vert.tobytes() + model.mesh_face.tobytes() + model.mesh_vertadr.tobytes())
    key = content.hexdigest(), size
    if key not in _TARGETS:
        small = decimated(model, drawn, FACES_PER_MESH)
        quality, window = small.vis.quality, small.vis.global_
        quality.offsamples = quality.shadowsize = 0
        quality.numslices, quality.numstacks, quality.numquads = 16, 10, 1  # spheres, capsules, planes
        window.offwidth = window.offheight = size
        with gl.context().as_current():
            _TARGETS[key] = mujoco.MjrContext(small, mujoco.mjtFontScale.mjFONTSCALE_50)
    return _TARGETS[key]


@atexit.register
def _free() -> None:
    """OpenGL wants its objects freed before the context that they live in."""
    while _TARGETS:
        with gl.context().as_current():
            _TARGETS.popitem()[1].free()
