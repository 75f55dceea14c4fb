"""Two Shadow Hands, and the scissors, the switches and the bottle that they work on."""

import subprocess
import sys
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest

from acgd.tasks import registry
from acgd.tasks.dexterous import DexterousTask
from acgd.tasks.kinds import bottle, scissors, switch
from acgd.tasks.robots import shadow
from acgd.tasks.settings import TaskConfig
from tests.open_loop import SOLUTIONS, follow

TASKS = [name for name, spec in registry.TASKS.items() if spec.suite == "bidex"]
ACTIONS = 2 * len(shadow.MOTORS)


@pytest.fixture(scope="module")
def envs() -> dict[str, DexterousTask]:
    """From the nominal start."""
    return {name: registry.make(TaskConfig(name=name, start="nominal"), image_size=None) for name in TASKS}


def _tell(env: DexterousTask, joint: str, value: float) -> None:
    """Set a joint of one degree of freedom by hand."""
    env.data.joint(joint).qpos[:] = value
    mujoco.mj_step1(env.model, env.data)


def test_two_right_hands_with_52_motors(envs):
    model = envs["bidex/scissors"].model
    assert (model.nq, model.nv, model.nu) == (68, 67, 52) == (68, 67, ACTIONS)
    names = [model.actuator(i).name.replace("robot0:A_", "") for i in range(model.nu)]
    assert names == [f"{side}/{motor}" for side in shadow.SIDES for motor in shadow.MOTORS]
    assert model.nsensor == 0 and model.ntendon == 8 and model.opt.timestep == 0.005


def test_fingertips_are_where_the_real_hand_has_them(envs):
    """All joints at zero, in the palm's frame: along the fingers 0.185 and 0.189 m, knuckles 22 mm apart."""
    env = envs["bidex/switch"]
    env.reset(seed=0)
    env.data.qpos[env.scene.robot.qpos] = 0.0
    mujoco.mj_kinematics(env.model, env.data)
    for side, tips in zip(shadow.SIDES, env.scene.hands.tips(env.data)):
        palm = env.data.body(f"{side}/robot0:palm")
        local = (tips - palm.xpos) @ palm.xmat.reshape(3, 3)
        assert np.allclose(
            local[:4], [(0.033, 0, 0.185), (0.011, 0, 0.189), (-0.011, 0, 0.185), (-0.034, 0, 0.178)], atol=2e-3
        )
        assert local[4, 0] > 0.09  # the thumb sticks out on the index finger's side, as a right hand's does
    tips = env.scene.hands.tips(env.data)
    assert np.allclose(tips[0] - tips[1], (0, 0.4, 0), atol=1e-9)


def test_a_base_slides_along_the_world_and_turns_about_the_palm(envs):
    env = envs["bidex/bottle"]  # whose hands are turned
    env.reset(seed=0)
    palm = env.data.body("right/robot0:palm")
    before, rotation = palm.xpos.copy(), palm.xmat.copy()
    for joint, value in zip("xyz", (0.01, 0.02, 0.03)):
        env.data.joint(f"right/{joint}").qpos[:] = value
    mujoco.mj_kinematics(env.model, env.data)
    assert np.allclose(palm.xpos - before, (0.01, 0.02, 0.03)) and np.allclose(palm.xmat, rotation)
    env.data.joint("right/roll").qpos[:] = 0.3
    mujoco.mj_kinematics(env.model, env.data)
    assert np.allclose(palm.xpos - before, (0.01, 0.02, 0.03)) and not np.allclose(palm.xmat, rotation)


def test_building_prints_nothing_and_leaves_no_file(tmp_path, monkeypatch, capfd):
    """MuJoCo writes a log into the working folder when merged models disagree."""
    monkeypatch.chdir(tmp_path)
    switch.Switch()
    assert not list(tmp_path.iterdir())
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("name", TASKS)
def test_nothing_starts_inside_of_anything_and_starts_are_near_or_far(name):
    env, heights = registry.make(name, image_size=None), []
    for seed in range(60):
        env.reset(seed=seed)
        assert not env.scene.failed(env.data) and not env.scene.met(env.data)
        assert min(env.data.contact.dist, default=0.0) > -5e-3
        heights.append(env.data.ctrl[:3].copy())
    spread = np.ptp(heights, axis=0)
    assert (spread > 2 * shadow.START_SLIDE).any()  # more than noise: two kinds of starts
    assert (spread < 0.25).all()


def test_switches_are_on_only_together(envs):
    env = envs["bidex/switch"]
    env.reset(seed=0)
    assert env.scene.terms(env.data)["travel"] == 0
    _tell(env, "rocker/right", 0.0)
    assert env.scene.terms(env.data)["travel"] == 1 and not env.scene.met(env.data)
    _tell(env, "rocker/left", (1 - switch.PRESSED - 0.01) * switch.OFF)
    assert env.scene.met(env.data)
    _tell(env, "rocker/left", (1 - switch.PRESSED + 0.01) * switch.OFF)
    assert not env.scene.met(env.data)


def test_a_rocker_stays_where_it_is_put(envs):
    env = envs["bidex/switch"]
    env.reset(seed=0)
    _tell(env, "rocker/right", 0.2)
    for _ in range(25):
        env.step(np.zeros(ACTIONS))
    assert env.data.joint("rocker/right").qpos[0] == pytest.approx(0.2, abs=0.02)


def test_scissors_are_open_from_an_angle_on_and_lost_below_the_table(envs):
    env = envs["bidex/scissors"]
    env.reset(seed=0)
    assert env.scene.terms(env.data)["opening"] == pytest.approx(0, abs=1e-9)
    _tell(env, "hinge", scissors.OPEN + 0.01)
    assert env.scene.met(env.data) and env.scene.terms(env.data)["opening"] == pytest.approx(0.5)
    handles = [env.data.site(f"handle/{side}").xpos for side in shadow.SIDES]
    assert handles[0][1] - handles[1][1] > 0.16  # they were 15 cm apart
    env.data.joint("scissors").qpos[:3] = 0.9, 0.0, 0.45  # beside the table
    mujoco.mj_step1(env.model, env.data)
    _, reward, terminated, truncated, info = env.step(np.zeros(ACTIONS))
    assert terminated and not truncated and info["reward_terms"]["failed"] == 1 and reward < -1


def test_the_left_hand_holds_the_bottle_by_itself(envs):
    env = envs["bidex/bottle"]
    env.reset(seed=0)
    for _ in range(env.task.horizon):
        _, _, terminated, _, info = env.step(np.zeros(ACTIONS))
        assert not terminated
    assert info["reward_terms"]["held"] > 0.5 and not info["success"]["once"]


def test_the_cap_counts_as_long_as_the_right_hand_touches_it(envs):
    env = envs["bidex/bottle"]
    env.reset(seed=0)
    _tell(env, "cap", bottle.OFF + 0.001)
    assert env.scene.met(env.data) and env.scene.terms(env.data)["travel"] == 0
    _, info = follow(env, SOLUTIONS["bidex/bottle"])
    assert info["reward_terms"]["travel"] == 1


@pytest.mark.parametrize("drop", [(0, 0, -0.2), (0, 0.25, 0)])
def test_a_bottle_out_of_the_hand_ends_the_episode(envs, drop):
    env = envs["bidex/bottle"]
    env.reset(seed=0)
    env.data.joint("bottle").qpos[:3] += drop
    mujoco.mj_step1(env.model, env.data)
    _, reward, terminated, truncated, info = env.step(np.zeros(ACTIONS))
    assert terminated and not truncated and info["reward_terms"]["failed"] == 1 and reward < -4


def test_the_original_rewards(envs):
    """Bi-DexHands': 2 - D - D, and progress times 50, 5 where both hands are near, or 30 where the right one is."""
    for name, progress in {"bidex/switch": -0.04, "bidex/scissors": 0.5, "bidex/bottle": 0.0}.items():
        env = registry.make(TaskConfig(name=name, start="nominal"), image_size=None, reward_weights={"original": 1.0})
        assert sum(weight != 0 for weight in env.reward_weights.values()) > 1  # the others are still there
        env.reset(seed=0)
        if name == "bidex/scissors":
            _tell(env, "hinge", scissors.CLOSED + progress)
        tips, palms = env.scene.hands.tips(env.data), env.scene.hands.palms(env.data)
        if name == "bidex/bottle":
            cap, body = env.data.body("cap").xpos, env.data.body("bottle").xpos
            expected = 2 - np.linalg.norm(tips[0] - cap, axis=1).sum() - np.linalg.norm(palms[1] - body)
        else:
            handles = np.array([env.data.site(f"handle/{side}").xpos for side in shadow.SIDES])
            far = sum(np.linalg.norm(tips[i] - handles[i], axis=1).sum() for i in range(2))
            up = 1.4 - handles[:, 2].sum()
            expected = 2 - far + (50 * up if name == "bidex/switch" else 0.0)  # the hands are not near the scissors
        assert env.scene.terms(env.data)["original"] == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize("found", [None, SimpleNamespace(submodule_search_locations=["/nowhere/gymnasium_robotics"])])
def test_a_missing_hand_names_the_mend(monkeypatch, found):
    monkeypatch.setattr(shadow, "find_spec", lambda name: found)
    with pytest.raises(FileNotFoundError, match="Shadow Hand.*pip install.*gymnasium-robotics==1.4.2"):
        switch.Switch()


def test_gymnasium_robotics_is_never_imported():
    """It would register environments of its own."""
    script = (
        "import sys; from acgd.tasks import registry; registry.make('bidex/switch', image_size=None); "
        "print('gymnasium_robotics' in sys.modules)"
    )
    assert (
        subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True).stdout.strip()
        == "False"
    )
