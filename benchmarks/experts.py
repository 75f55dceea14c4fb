"""Training of experts in one thread: SAC updates against stable-baselines3 at equal sizes, and the parts of a step:
`python -m benchmarks.experts`."""

import statistics
import time
import warnings
from collections.abc import Callable

import gymnasium
import numpy as np
import torch

from acgd.experts.sac.settings import SACSettings
from acgd.experts.sac.update import SACUpdate
from acgd.experts.settings import ExpertRequest
from acgd.experts.training_env import StateOnly
from acgd.tasks.settings import TaskConfig
from benchmarks.row import Row

STATE_DIM, ACTION_DIM = 115, 39
"""Sizes of myo/reach."""
ROUNDS, UPDATES = 25, 10
"""The median round counts. The variants take turns, so that other processes slow all of them."""
TASK = "myo/obj-hold"
STEPS = 400
LEAST_RATIO = 2.0
"""Smallest accepted speed over that of stable-baselines3."""


def run() -> list[Row]:
    """Updates per second of three variants, and environment steps per second.

    The reference of the ratio is stable-baselines3 at equal sizes for updates, and the physics for environment steps.
    """
    torch.set_num_threads(1)
    variants = {
        "SAC, default": SACSettings(),
        "SAC, a policy update with every critic update": SACSettings(actor_every=1),
        "SAC, float32": SACSettings(precision="float32"),
    }
    calls = {name: _project(sac) for name, sac in variants.items()} | {"stock": _stock(SACSettings())}
    rates = {name: 1 / seconds for name, seconds in _alternating(calls).items()}
    rows = [
        Row(name=f"experts/{name}", value=rates[name], unit="updates/s", ratio=rates[name] / rates["stock"],
            target=f">= {LEAST_RATIO:g} x stable-baselines3's" if name == "SAC, default" else "",
            met=rates[name] >= LEAST_RATIO * rates["stock"] if name == "SAC, default" else None)
        for name in variants
    ]  # fmt: skip
    rows.append(
        Row(
            name="experts/stable-baselines3's SAC",
            value=rates["stock"],
            unit="updates/s",
            ratio=None,
            target="",
            met=None,
        )
    )
    return [*rows, *_steps(SACSettings(), rates["SAC, default"])]


def _project(sac: SACSettings) -> Callable[[], None]:
    learner = SACUpdate(STATE_DIM, ACTION_DIM, sac, torch.Generator().manual_seed(0))
    g = torch.Generator().manual_seed(1)
    n = sac.batch
    batch = (
        torch.randn(n, STATE_DIM, generator=g),
        torch.rand(n, ACTION_DIM, generator=g) * 2 - 1,
        torch.randn(n, generator=g),
        torch.randn(n, STATE_DIM, generator=g),
        torch.full((n,), sac.gamma),
    )
    return lambda: [learner.update(batch) for _ in range(UPDATES)]


class _Nothing(gymnasium.Env):
    """An environment with the same spaces, which is never stepped."""

    observation_space = gymnasium.spaces.Box(-10, 10, (STATE_DIM,), np.float32)
    action_space = gymnasium.spaces.Box(-1, 1, (ACTION_DIM,), np.float32)


def _stock(sac: SACSettings) -> Callable[[], None]:
    from stable_baselines3 import SAC
    from stable_baselines3.common.logger import configure

    model = SAC(
        "MlpPolicy", _Nothing(), buffer_size=1000, device="cpu", policy_kwargs={"net_arch": [sac.width, sac.width]}
    )
    model.set_logger(configure(None, []))
    rng = np.random.default_rng(0)
    for _ in range(1000):
        model.replay_buffer.add(
            rng.normal(size=STATE_DIM),
            rng.normal(size=STATE_DIM),
            rng.uniform(-1, 1, ACTION_DIM),
            np.zeros(1),
            np.zeros(1),
            [{}],
        )
    return lambda: model.train(UPDATES, sac.batch)


def _alternating(calls: dict[str, Callable[[], None]]) -> dict[str, float]:
    """Processor seconds per update, median over rounds."""
    seconds: dict[str, list[float]] = {name: [] for name in calls}
    for _ in range(ROUNDS):
        for name, call in calls.items():
            started = time.process_time()
            call()
            seconds[name].append((time.process_time() - started) / UPDATES)
    return {name: statistics.median(result[1:]) for name, result in seconds.items()}


def _steps(sac: SACSettings, updates_per_second: float) -> list[Row]:
    """Rows of one environment: its step, and a training step with its share of updates."""
    env = StateOnly(ExpertRequest(task=TaskConfig(name=TASK), expert=sac), 0)
    env.reset()
    base, rng = env.unwrapped.base, np.random.default_rng(0)
    import mujoco

    started = time.process_time()
    for _ in range(STEPS):
        _, _, terminated, truncated, _ = env.step(rng.uniform(-1, 1, ACTION_DIM))
        if terminated or truncated:
            env.reset()
    step = (time.process_time() - started) / STEPS
    env.reset()
    started = time.process_time()
    for _ in range(STEPS):
        base.data.ctrl[:] = 1 / (1 + np.exp(-5 * (rng.uniform(-1, 1, ACTION_DIM) - 0.5)))
        mujoco.mj_step(base.model, base.data, base.frame_skip)
    physics = (time.process_time() - started) / STEPS
    total = step + sac.updates_per_step / updates_per_second
    return [
        Row(
            name=f"experts/{TASK}: environment",
            value=1 / step,
            unit="steps/s",
            ratio=physics / step,
            target="(ratio: physics' share)",
            met=None,
        ),
        Row(
            name=f"experts/{TASK}: SAC, all in all",
            value=1 / total,
            unit="steps/s",
            ratio=physics / total,
            target="(ratio: physics' share)",
            met=None,
        ),
    ]


if __name__ == "__main__":
    warnings.simplefilter("ignore")
    for row in run():
        print(row)
