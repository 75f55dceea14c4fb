"""The environment of position-controlled hands, the Allegro hand, and the spray bottles."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from acgd.collection.demonstrations import run_wave
from acgd.collection.settings import RolloutsConfig
from acgd.experts.policy import Expert
from acgd.simulate.lockstep import Lockstep
from acgd.tasks import registry, spray
from acgd.tasks.dexterous import AFTERWARDS, SMOOTHING, DexterousTask
from acgd.tasks.robots import allegro
from acgd.tasks.settings import TaskConfig
from acgd.tasks.snapshot import Snapshot
from acgd.tasks.spray import HOLD_STEPS
from tests.open_loop import SOLUTIONS, follow

TASKS = [name for name, spec in registry.TASKS.items() if spec.suite in ("bidex", "opdex")]
SPRAYS = [name for name in TASKS if registry.TASKS[name].suite == "opdex"]


@pytest.fixture(scope="module")
def envs() -> dict[str, DexterousTask]:
    return {name: registry.make(TaskConfig(name=name, start="nominal"), image_size=None) for name in TASKS}


@pytest.fixture(scope="module")
def env(envs) -> DexterousTask:
    return envs["opdex/spray-1"]


def test_forward_kinematics_of_the_allegro_hand():
    """Against the real hand's fingertips in the palm's frame, all joints at zero."""
    spec = mujoco.MjSpec()
    spec.compiler.degree = False
    allegro.add_hand(spec, (0, 0, 0), (1, 0, 0, 0), np.array([(-0.1, 0.1)] * 6))
    model = spec.compile()
    data = mujoco.MjData(model)
    data.qpos[:] = 0
    mujoco.mj_kinematics(model, data)
    tips = [data.site(name).xpos for name in allegro.TIPS]
    known = [(0, 0.0553, 0.1334), (0, 0, 0.1362), (0, -0.0553, 0.1334), (-0.0132, 0.1677, -0.0861)]
    assert np.allclose(tips, known, atol=1e-4)
    assert (model.nq, model.nu) == (22, 22)
    assert (
        [model.joint(i).name for i in range(22)] == [model.actuator(i).name for i in range(22)] == list(allegro.JOINTS)
    )


def test_the_wrist_slides_along_the_axes_of_the_world(env):
    env.reset(seed=0)
    data = env.data
    before = data.body("palm").xpos.copy()
    data.qpos[env.scene.robot.qpos[:3]] += (0.01, 0.02, 0.03)
    mujoco.mj_kinematics(env.model, data)
    assert np.allclose(data.body("palm").xpos - before, (0.01, 0.02, 0.03))


@pytest.mark.parametrize("name", TASKS)
def test_an_open_loop_solution_succeeds_and_its_actions_repeat_it(envs, name):
    env = envs[name]
    actions, info = follow(env, SOLUTIONS[name])
    assert info["success"] == {"final": True, "held": True, "once": True}
    done = sum(env.reward_weights[term] * value for term, value in info["reward_terms"].items())
    assert 4 < done < 8
    env.reset(seed=1)
    for action in actions:
        again = env.step(action)[4]
    assert again["reward_terms"] == info["reward_terms"]


@pytest.mark.parametrize("name", TASKS)
def test_a_random_policy_never_succeeds_and_the_simulation_stays_sound(name):
    """2000 steps of random actions, then as many from one end of the box to the other."""
    env, rng = registry.make(name, image_size=None), np.random.default_rng(0)
    for extreme in (False, True):
        env.reset(seed=0)
        for t in range(2000):
            action = rng.uniform(-1, 1, env.action_space.shape)
            obs, reward, terminated, truncated, info = env.step(1e6 * action if extreme else action)
            assert np.isfinite(obs["state"]).all() and abs(reward) < 20
            assert extreme or not info["success"]["once"]
            assert not env.data.warning.number.any()
            if terminated or truncated:
                env.reset(seed=t)


@pytest.mark.parametrize("name", SPRAYS)
def test_doing_nothing_is_worth_little(envs, name):
    envs[name].reset(seed=0)
    assert 0 <= envs[name].step(np.zeros(22))[1] < 0.5


def test_an_episode_ends_as_a_truncation_some_steps_after_success(env):
    env.reset(seed=0)
    actions, _ = follow(env, SOLUTIONS["opdex/spray-1"])
    env.reset(seed=0)
    solved = []
    for action in actions:
        _, _, terminated, truncated, info = env.step(action)
        solved.append(info["solved"])
    assert truncated and not terminated and env.steps < env.task.horizon
    assert sum(solved) == AFTERWARDS + 1 and all(solved[-AFTERWARDS - 1 :])
    env.reset(seed=0)
    env.ignore_time_limit = True
    assert not any(env.step(action)[3] for action in actions)
    env.ignore_time_limit = False


def test_success_takes_ten_steps_in_a_row(env, monkeypatch):
    """A press that is let go in between counts from the start again."""
    env.reset(seed=0)
    pressed = [t != 5 for t in range(HOLD_STEPS + 6)]
    outcomes = iter(pressed)
    monkeypatch.setattr(env.scene, "met", lambda data: next(outcomes))
    steps = [env.step(np.zeros(22)) for _ in pressed]
    assert [step[4]["solved"] for step in steps] == [False] * (len(pressed) - 1) + [True]
    held = [step[0]["state"][env.state_layout["held"]].item() for step in steps]
    assert held == pytest.approx(
        [min(n, HOLD_STEPS) / HOLD_STEPS for n in (1, 2, 3, 4, 5, 0, *range(1, HOLD_STEPS + 1))]
    )


def test_a_toppled_bottle_ends_the_episode(env):
    env.reset(seed=0)
    place = env.model.joint("bottle").qposadr[0]
    env.data.qpos[place + 3 : place + 7] = [np.cos(0.4), np.sin(0.4), 0, 0]
    mujoco.mj_step1(env.model, env.data)
    _, reward, terminated, truncated, info = env.step(np.zeros(22))
    assert terminated and not truncated and info["reward_terms"]["failed"] == 1 and reward < -4


def test_actions_move_smoothed_targets(env):
    env.reset(seed=0)
    start, stride = env.data.ctrl.copy(), env.scene.robot.stride
    action = np.zeros(22)
    action[[0, 7]] = 1.0
    obs = env.step(action)[0]
    assert np.allclose(env.data.ctrl - start, SMOOTHING * stride * action)
    assert np.allclose(obs["state"][env.state_layout["targets"]], env.data.ctrl)
    assert np.allclose(obs["state"][env.state_layout["moving"]], SMOOTHING * action)
    env.step(np.zeros(22))
    assert np.allclose(env.data.ctrl - start, SMOOTHING * (2 - SMOOTHING) * stride * action)


def test_a_recorded_step_holds_all_that_was_observed():
    """The simulator's state alone: targets, smoothed action and pictures come back with it."""
    lock = Lockstep(TaskConfig(name="opdex/spray-2"), 1, image_size=32)
    size = lock.envs[0].observation_space["state"].shape[0]
    episode = run_wave(Expert.random(size, 22), lock, [5], RolloutsConfig())[0]
    for t in (0, 20, 60):
        seen = lock.envs[0].restore(Snapshot(episode["integration"][t], {}))
        for name in ("image", "proprio", "state"):
            assert np.array_equal(seen[name], episode[name][t])


def test_starts_are_near_or_far_within_their_ranges():
    env = registry.make("opdex/spray-1", image_size=None)
    wrists, places = [], []
    for seed in range(60):
        env.reset(seed=seed)
        wrists.append(env.data.qpos[env.scene.robot.qpos[:3]])
        places.append(env.data.body("bottle").xpos[:2].copy())
        assert not env.scene.failed(env.data)
        assert (env.data.contact.dist > -2e-3).all(), "the hand starts inside the bottle"
    middle = (spray.NEAR_WRIST[1] + spray.FAR_WRIST[1]) / 2
    assert 0.1 < np.mean(np.array(wrists)[:, 1] < middle) < 0.5
    assert np.abs(places).max() <= spray.PLACE_NOISE and np.std(places) > 0.3 * spray.PLACE_NOISE


def test_a_wrong_snapshot_start_or_action_is_named(env, monkeypatch):
    snapshot = env.snapshot()
    with pytest.raises(ValueError, match="of another task"):
        env.restore(replace(snapshot, integration=snapshot.integration[1:]))
    with pytest.raises(ValueError, match="not a number"):
        env.step(np.full(22, np.nan))
    monkeypatch.setattr(spray, "FAR_WRIST", spray.FAR_WRIST - 0.1)
    with pytest.raises(ValueError, match="wrist_y.*outside.*narrow its starts"):
        env.reset(seed=0)
