"""Fast offscreen pictures of a simulation. Rendering does not change the simulation.

With MuJoCo's defaults an 84 px picture of a MyoSuite hand takes 120 to 370 ms on a software renderer. Nearly all of the
time goes into invisible vertices (178,021 faces of bones, room and logo), multisampling, shadows and tendons. This
renderer builds the scene from the physics model, so that all changes of a reset are visible, and renders it with the
decimated meshes of a copy.
"""

import atexit
import hashlib

import numpy as np

from acgd.tasks.rendering import gl
from acgd.tasks.rendering.camera import Camera
from acgd.tasks.rendering.meshes import decimated
from acgd.tasks.simulator import mujoco

FACES_PER_MESH = 64
"""Triangles of a decimated mesh. At 84 px a bone covers a few dozen pixels."""
ROUND = 12, 6
"""Slices and stacks of the meshes of spheres, ellipsoids and cylinders."""
_SHOWN = 0
"""The rendered group: bones, objects and goal markers. Rooms, wrapping surfaces, skins and muscle sites are not."""
_CATEGORIES = mujoco.mjtCatBit.mjCAT_STATIC | mujoco.mjtCatBit.mjCAT_DYNAMIC


class Renderer:
    """Renders a simulation. All renderers of a process share the OpenGL context, and equal meshes."""

    def __init__(self, model: mujoco.MjModel, *, camera: Camera, size: int = 84) -> None:
        self.size = size
        self._model = model
        self._camera = camera.build()
        self._sun = camera.direction(turned=20.0, raised=25.0)
        self._viewport = mujoco.MjrRect(0, 0, size, size)
        self._buffer = np.empty((size, size, 3), np.uint8)
        self._option = _options()
        self._scene = mujoco.MjvScene(model, maxgeom=model.ngeom + model.nsite)
        self._scene.flags[:] = 0
        self._scene.flags[mujoco.mjtRndFlag.mjRND_CULL_FACE] = 1
        self._target = _target(model, size)

    def render(self, data: mujoco.MjData) -> np.ndarray:
        """The picture (size, size, 3) uint8 of `data`, whose kinematics must be current. `data` is not changed."""
        scene = self._scene
        mujoco.mjv_updateScene(self._model, data, self._option, None, self._camera, _CATEGORIES, scene)
        self._light()
        with gl.drawing():
            mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self._target)
            mujoco.mjr_render(self._viewport, scene, self._target)
            mujoco.mjr_readPixels(self._buffer, None, self._viewport, self._target)
        return self._buffer[::-1].copy()  # OpenGL's first row is the lowest row

    def _light(self) -> None:
        """Sets one directional light beside the camera. The lights of the models differ, and each light costs time."""
        self._scene.nlight = 1
        light = self._scene.lights[0]
        light.type = mujoco.mjtLightType.mjLIGHT_DIRECTIONAL
        light.headlight = light.castshadow = 0
        light.dir = self._sun
        light.ambient, light.diffuse, light.specular = (0.4,) * 3, (0.6,) * 3, (0.1,) * 3


def _options() -> mujoco.MjvOption:
    option = mujoco.MjvOption()
    option.flags[:] = 0
    option.flags[mujoco.mjtVisFlag.mjVIS_STATIC] = 1
    for groups in (option.geomgroup, option.sitegroup):
        groups[:] = 0
        groups[_SHOWN] = 1
    return option


def drawn_meshes(model: mujoco.MjModel) -> set[int]:
    """Indices of the rendered meshes."""
    meshes = (model.geom_type == mujoco.mjtGeom.mjGEOM_MESH) & (model.geom_group == _SHOWN)
    return set(model.geom_dataid[meshes].tolist())


_TARGETS: dict[tuple[str, int], mujoco.MjrContext] = {}
"""(digest of the meshes, size) -> framebuffer and meshes. Tasks with the same hand share one entry."""


def _target(model: mujoco.MjModel, size: int) -> mujoco.MjrContext:
    drawn = drawn_meshes(model)
    content = hashlib.sha256(repr(sorted(drawn)).encode())
    content.update(model.mesh_vert.tobytes() + model.mesh_face.tobytes() + model.mesh_vertadr.tobytes())
    key = content.hexdigest(), size
    if key in _TARGETS:
        return _TARGETS[key]
    with gl.drawing():
        if key in _TARGETS:  # by another thread in the meantime
            return _TARGETS[key]
        small = decimated(model, drawn, FACES_PER_MESH)
        quality, window = small.vis.quality, small.vis.global_
        quality.offsamples = quality.shadowsize = 0
        quality.numslices, quality.numstacks = ROUND
        window.offwidth = window.offheight = size
        try:
            made = mujoco.MjrContext(small, mujoco.mjtFontScale.mjFONTSCALE_50)
        except mujoco.FatalError as error:
            mend = f"Install a newer driver, or Mesa's software renderer ({gl.INSTALL})."
            raise gl.GraphicsError(gl.explain(f"OpenGL does not work: {error}", mend)) from error
        if not _TARGETS:
            atexit.register(_free)
        _TARGETS[key] = made
        return made


def _free() -> None:
    """Frees OpenGL objects before their context, whose exit handler was registered earlier and runs later."""
    if gl.inherited():
        return
    with gl.drawing():
        while _TARGETS:
            _TARGETS.popitem()[1].free()
