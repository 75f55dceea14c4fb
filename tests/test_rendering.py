"""Pictures: frugal, deterministic, faithful to the model as the reset left it, and without effect on physics."""

import hashlib
import os
import subprocess
import sys

import mujoco
import numpy as np
import pytest

from acgd.tasks import registry
from acgd.tasks.rendering import gl
from acgd.tasks.rendering.meshes import decimated, smooth_normals
from acgd.tasks.rendering.renderer import FACES_PER_MESH, Renderer, drawn_meshes

TASKS = {spec.kind: name for name, spec in registry.TASKS.items() if not name.endswith("-hard")}
KINDS = sorted(TASKS)
SIZE = 84
GREY = {"myo": 120, "bidex": 50, "opdex": 50}
"""Least brightness of a pixel of the hand: bones are white, robots are not."""


@pytest.fixture(scope="module")
def envs():
    made = {kind: registry.make(name, image_size=None) for kind, name in TASKS.items()}
    yield made
    for env in made.values():
        env.close()


def _renderer(env) -> Renderer:
    return Renderer(env.model, camera=env.task.code().CAMERA, size=SIZE)


def _changed(before: np.ndarray, after: np.ndarray) -> int:
    """Pixels that differ clearly."""
    return int((np.abs(before.astype(int) - after.astype(int)).max(axis=2) > 24).sum())


@pytest.mark.parametrize("kind", KINDS)
def test_a_picture_shows_the_hand_and_owns_its_memory(envs, kind):
    env = envs[kind]
    env.reset(seed=0)
    renderer = _renderer(env)
    image = renderer.render(env.data)
    assert image.shape == (SIZE, SIZE, 3) and image.dtype == np.uint8
    lit = (image.max(axis=2) > 40).mean()
    assert 0.03 < lit < 0.95
    hand = (image.min(axis=2) > GREY[env.task.suite]) & (np.ptp(image.astype(int), axis=2) < 20)
    assert hand.sum() > 150
    kept = image.copy()
    env.step(np.ones(env.action_space.shape))
    assert _changed(image, renderer.render(env.data)) > 0
    assert np.array_equal(image, kept)


@pytest.mark.parametrize("kind", KINDS)
def test_physics_is_bit_equal_with_and_without_pictures(envs, kind):
    env = envs[kind]
    actions = np.random.default_rng(0).uniform(-1, 1, (8, *env.action_space.shape))
    state = np.empty(mujoco.mj_stateSize(env.model, mujoco.mjtState.mjSTATE_INTEGRATION))

    def roll(draw: bool) -> list[bytes]:
        env.reset(seed=3)
        renderer = _renderer(env)
        states = []
        for action in actions:
            if draw:
                renderer.render(env.data)
            env.step(action)
            mujoco.mj_getState(env.model, env.data, state, mujoco.mjtState.mjSTATE_INTEGRATION)
            states.append(state.tobytes())
        return states

    assert roll(draw=True) == roll(draw=False)


def test_the_same_state_gives_the_same_bytes_in_any_renderer_and_order(envs):
    """Tasks share a context, and equal hands share meshes: neither may leave traces."""
    alone = {}
    for kind, env in envs.items():
        env.reset(seed=1)
        alone[kind] = _renderer(env).render(env.data)
    renderers = {kind: _renderer(env) for kind, env in envs.items()}
    large = Renderer(envs["reach"].model, camera=envs["reach"].task.code().CAMERA, size=120)
    for _ in range(2):
        for kind, env in envs.items():
            assert large.render(envs["reach"].data).shape == (120, 120, 3)
            assert np.array_equal(renderers[kind].render(env.data), alone[kind])


def test_another_process_draws_the_same_bytes(envs):
    env = envs["obj-hold"]
    env.reset(seed=2)
    here = hashlib.sha256(_renderer(env).render(env.data)).hexdigest()
    script = (
        "import hashlib\nfrom acgd.tasks import registry\n"
        "from acgd.tasks.rendering.renderer import Renderer\n"
        "env = registry.make('myo/obj-hold', image_size=None); env.reset(seed=2)\n"
        f"image = Renderer(env.model, camera=env.task.code().CAMERA, size={SIZE}).render(env.data)\n"
        "print(hashlib.sha256(image).hexdigest())\n"
    )
    ran = _python(script)
    assert ran.returncode == 0, ran.stderr
    assert ran.stdout.split()[-1] == here


@pytest.mark.parametrize(
    ("kind", "move"),
    [
        ("key-turn", lambda env: env.model.body_pos[env.model.body("key").id].__iadd__([0, 0, 0.02])),
        ("obj-hold", lambda env: env.model.site_pos[env.model.site("goal").id].__iadd__([0.01, 0, 0])),
        ("obj-hold", lambda env: env.model.geom_size[-1].__imul__(0.7)),
        ("pen-twirl", lambda env: np.copyto(env.model.body_quat[env.model.body("target").id], [1, 0, 0, 0])),
        ("pose", lambda env: env.model.site_pos[env.model.site("IFtip_r_target").id].__iadd__([0, 0, 0.02])),
        ("reach", lambda env: env.model.site_pos[env.model.site("THtip_r_target").id].__iadd__([0, 0, 0.02])),
    ],
)  # fmt: skip
def test_what_a_reset_writes_into_the_model_shows(envs, kind, move):
    env = envs[kind]
    env.reset(seed=0)
    renderer = _renderer(env)
    before = renderer.render(env.data)
    move(env)
    mujoco.mj_forward(env.model, env.data)
    after = renderer.render(env.data)
    env.reset(seed=0)  # puts the model back
    assert _changed(before, after) >= 5


@pytest.mark.parametrize(
    ("kind", "joint", "by"),
    [
        ("key-turn", "keyjoint", np.pi),  # half a turn
        ("obj-hold", -7, 0.01),  # the first of a free joint: one centimetre
        ("pen-twirl", -6, 0.01),
        ("spray-1", "bottle", 0.01),
        ("spray-1", "trigger", 0.35),
        ("spray-2", "trigger", 0.35),
    ],
)
def test_the_object_moves_pixels(envs, kind, joint, by):
    """`joint` by its name or as an index into qpos."""
    env = envs[kind]
    env.reset(seed=0)
    renderer = _renderer(env)
    before = renderer.render(env.data)
    env.data.qpos[env.model.joint(joint).qposadr[0] if isinstance(joint, str) else joint] += by
    mujoco.mj_forward(env.model, env.data)
    assert _changed(before, renderer.render(env.data)) >= 10


def test_decimation_keeps_to_its_budget_and_to_the_shape(envs):
    model = envs["obj-hold"].model
    drawn = drawn_meshes(model)
    small = decimated(model, drawn, FACES_PER_MESH)
    assert small.mesh_facenum.sum() < 3_000
    for i in range(model.nmesh):
        faces, first = int(small.mesh_facenum[i]), model.mesh_vertadr[i]
        if i not in drawn:
            assert faces == 0
            continue
        assert 0 < faces <= FACES_PER_MESH + 4
        points = small.mesh_vert[first : first + small.mesh_vertnum[i]]
        whole = model.mesh_vert[first : first + model.mesh_vertnum[i]]
        margin = 0.004  # metres: a pixel or two
        assert np.all(points > whole.min(axis=0) - margin) and np.all(points < whole.max(axis=0) + margin)  # no spikes
        lost = np.ptp(whole, axis=0) - np.ptp(points, axis=0)
        assert np.all(lost < margin + 0.02 * np.ptp(whole, axis=0).max())  # and nothing caved in
    assert model.mesh_facenum.sum() > 100_000  # the model itself is as it was


def test_smooth_normals_point_outwards():
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], float)
    faces = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    normals = smooth_normals(corners, faces)
    assert np.allclose(np.linalg.norm(normals, axis=1), 1)
    assert np.allclose(normals[0], -np.ones(3) / np.sqrt(3))


@pytest.mark.parametrize(
    ("changed", "names"),
    [
        ({"__EGL_VENDOR_LIBRARY_FILENAMES": "/nonexistent.json"}, ("libegl1", "libgl1-mesa-dri", "egl")),
        ({"MUJOCO_GL": "nonsense"}, ("MUJOCO_GL=nonsense", "MUJOCO_GL=egl", "osmesa")),
    ],
)
def test_without_opengl_the_error_names_the_mend(changed, names):
    """No driver, and a backend that does not exist."""
    ran = _python("from acgd.tasks.rendering import gl\ngl.context()\n", changed)
    assert ran.returncode != 0
    assert "GraphicsError" in ran.stderr
    for name in names:
        assert name in ran.stderr


def test_backend_needs_no_setting(monkeypatch):
    monkeypatch.delenv("MUJOCO_GL", raising=False)
    monkeypatch.setattr(sys, "platform", "linux")
    assert gl.backend() == "egl"
    monkeypatch.setenv("MUJOCO_GL", "osmesa")
    assert gl.backend() == "osmesa"


def _python(script: str, changed: dict[str, str] | None = None) -> subprocess.CompletedProcess[str]:
    """Run in a fresh process, with MUJOCO_GL unset but for what `changed` says."""
    kept = {name: value for name, value in os.environ.items() if name not in ("MUJOCO_GL", "PYOPENGL_PLATFORM")}
    return subprocess.run(
        [sys.executable, "-c", script], env=kept | (changed or {}), capture_output=True, text=True, check=False
    )
