"""Environments as people drive them: faulty arguments, render modes, copies, threads, vector environments."""

import copy
import pickle
import threading

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from acgd.tasks import registry
from acgd.tasks.settings import TaskConfig
from acgd.tasks.spec import TASKS

NAMES = ("myo/reach", "bidex/switch", "opdex/spray-1")
"""A task of each suite."""
COPIED = ("myo/obj-hold-hard", "myo/pose-hard", "myo/key-turn", "bidex/bottle", "opdex/spray-2")
"""Tasks whose resets write model fields, target angles, or neither."""


def gym_id(name: str) -> str:
    return f"acgd.tasks.gymnasium_ids:acgd/{TASKS[name].slug}-v0"


@pytest.fixture(scope="module")
def envs():
    return {name: registry.make(name, image_size=None) for name in NAMES}


@pytest.mark.parametrize("name", NAMES)
def test_faulty_actions_are_refused_and_leave_the_episode_as_it_is(envs, name):
    env = envs[name]
    size = env.model.nu
    env.reset(seed=1)
    expected = env.step(np.full(size, 0.5, np.float32))[0]["state"]
    env.reset(seed=1)
    one = np.zeros(size)
    one[3] = np.nan
    faulty = [
        (np.full(size, np.nan), "entry 0 is not a number"),
        (one, "entry 3 is not a number"),
        (np.where(np.arange(size) == 2, -np.inf, 0.0), "entry 2 is infinite"),
        (0.0, rf"shape \({size},\), not \(\)"),
        (np.zeros(1), r"not \(1,\)"),
        (np.zeros((1, size)), "one action per environment"),
        (np.zeros(size + 1), rf"not \({size + 1},\)"),
        ({"action": 1}, f"{size} numbers"),
        (["a"] * size, f"{size} numbers"),
    ]
    for action, message in faulty:
        with pytest.raises(ValueError, match=f"{name}.*{message}"):
            env.step(action)
    assert np.array_equal(env.step([0.5] * size)[0]["state"], expected), "a list is an action too"


@pytest.mark.parametrize("name", NAMES)
def test_large_actions_are_clipped(envs, name):
    env = envs[name]
    states = []
    for scale in (1.0, 7.0):
        env.reset(seed=1)
        states.append(env.step(np.full(env.model.nu, scale, np.float32))[0]["state"])
    assert np.array_equal(*states)


@pytest.mark.parametrize("name", NAMES)
def test_options_that_a_task_does_not_know_are_refused(envs, name):
    env = envs[name]
    with pytest.raises(ValueError, match=f"{name} does not know the option advance; it has none"):
        env.reset(seed=1, options={"advance": 0.5})
    with pytest.raises(ValueError, match="as a dict"):
        env.reset(seed=1, options=[1])
    env.reset(seed=1, options={})


def test_the_option_advance_is_a_share():
    env = registry.make("myo/key-turn", image_size=None)
    with pytest.raises(ValueError, match="option advanced; its options are: advance"):
        env.reset(seed=1, options={"advanced": 0.5})
    for share in (-0.1, 1.5, np.nan, "half"):
        with pytest.raises(ValueError, match=r"share of the way in \[0, 1\]"):
            env.reset(seed=1, options={"advance": share})


@pytest.mark.parametrize("name", NAMES)
def test_gymnasium_checker_draws_and_passes(name):
    env = gymnasium.make(gym_id(name), render_mode="rgb_array", image_size=32)
    assert env.render_mode == "rgb_array"
    check_env(env.unwrapped)


def test_a_render_mode_that_does_not_exist_is_refused():
    with pytest.raises(ValueError, match="render_mode 'ansi': use render_mode='rgb_array'"):
        registry.make("opdex/spray-1", image_size=None, render_mode="ansi")
    assert registry.make("opdex/spray-1", image_size=None, render_mode=None).render_mode is None


@pytest.mark.parametrize("name", COPIED)
@pytest.mark.parametrize("way", ["copy", "deepcopy", "pickle"])
def test_a_copy_continues_bit_for_bit_and_on_its_own(name, way):
    env = registry.make(TaskConfig(name=name), image_size=None, reward_weights={})
    env.reset(seed=3)
    moves = np.random.default_rng(0).uniform(-1, 1, (6, env.model.nu)).astype(np.float32)
    for move in moves[:3]:
        env.step(move)
    env.ignore_time_limit = True
    ways = {"copy": copy.copy, "deepcopy": copy.deepcopy, "pickle": lambda env: pickle.loads(pickle.dumps(env))}
    other = ways[way](env)
    for move in moves[3:]:
        other.step(-move)  # the copy leaves the original as it is
    other.restore(env.snapshot())
    for move in moves[3:]:
        mine, theirs = env.step(move), other.step(move)
        assert np.array_equal(mine[0]["state"], theirs[0]["state"]) and mine[1:4] == theirs[1:4]
    assert other.ignore_time_limit and other.steps == env.steps == 6
    first, second = env.reset()[0], other.reset()[0]
    if way != "copy":
        assert np.array_equal(first["state"], second["state"]), "the random generators are equal and separate"


def test_a_copy_of_an_environment_that_has_drawn_draws_the_same():
    env = gymnasium.make(gym_id("opdex/spray-1"), image_size=32)
    env.reset(seed=1)
    other = copy.deepcopy(env)
    assert np.array_equal(env.render(), other.render()) and other.unwrapped.spec.id == env.unwrapped.spec.id


def test_several_threads_draw_the_same_pictures():
    """Before and after the main thread has drawn, and at the same time."""
    name, pictures, faults = "opdex/spray-1", {}, []

    def draw(number: int) -> None:
        try:
            env = registry.make(name, image_size=40)
            env.reset(seed=number % 2)
            pictures[number] = [env.step(np.full(env.model.nu, 0.3))[0]["image"] for _ in range(5)]
        except Exception as error:
            faults.append(error)

    draw(0), draw(1)
    threads = [threading.Thread(target=draw, args=(number,)) for number in range(2, 6)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not faults
    assert all(np.array_equal(pictures[number], pictures[number % 2]) for number in range(6))
    drawn = registry.make(name, image_size=40)
    drawn.reset(seed=0)
    passed: list[np.ndarray] = []
    handed_over = threading.Thread(target=lambda: passed.append(drawn.render()))
    handed_over.start(), handed_over.join()
    assert np.array_equal(passed[0], drawn.render())


@pytest.mark.parametrize(
    "mode, settings", [("sync", {}), ("async", {"context": "fork"}), ("async", {"context": "spawn"})]
)
def test_vector_environments_equal_single_ones(mode, settings):
    env = gymnasium.make(gym_id("opdex/spray-1"), image_size=32, render_mode="rgb_array")
    moves = np.random.default_rng(0).uniform(-1, 1, (3, 2, env.action_space.shape[0])).astype(np.float32)
    vector = gymnasium.make_vec(
        gym_id("opdex/spray-1"), 2, mode, vector_kwargs=settings, image_size=32, render_mode="rgb_array"
    )
    try:
        seen = [vector.reset(seed=[4, 5])[0], *(vector.step(move)[0] for move in moves)]
        assert np.array(vector.render()).shape == (2, 32, 32, 3)
    finally:
        vector.close()
    for i, seed in enumerate((4, 5)):
        alone = [env.reset(seed=seed)[0], *(env.step(move[i])[0] for move in moves)]
        assert np.array_equal(seen[-1]["image"][i], alone[-1]["image"])
        assert np.array_equal(seen[-1]["state"][i], alone[-1]["state"])
