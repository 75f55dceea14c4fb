"""BiDex and OpDex in one thread: speed, stability under random and extreme actions, success of a random policy:
`python -m benchmarks.dexterous [TASK ...]`."""

import resource
import statistics
import sys
import time
from collections.abc import Callable, Sequence

import numpy as np

from acgd.tasks import registry
from acgd.tasks.dexterous import DexterousTask
from acgd.tasks.rendering.renderer import Renderer
from benchmarks.row import Row

TASKS = tuple(name for name, spec in registry.TASKS.items() if spec.suite in ("bidex", "opdex"))
LEAST_STEPS = {"bidex": 1000.0, "opdex": 2500.0}
LEAST_FRAMES = 250.0
SIZE = 84
CHUNK = 50
"""Steps or frames of one time measurement. The median measurement counts."""
TIMED = 2000
"""Steps of the measurement of speed."""
STEPS, FRAMES = 100_000, 400
"""Steps of the stability test, half of them random and half extreme; frames of the measurement of rendering."""
SETTLED = 5_000
"""Steps after which the memory must not grow."""
MOST_GROWTH = 2.0
"""Largest accepted growth of memory in MB, a few pages of the allocator."""
EPISODES = 50
"""Episodes of the random policy."""


def run(tasks: Sequence[str] = TASKS) -> list[Row]:
    """Five rows per task."""
    return [row for task in tasks for row in _measure(task)]


def _measure(task: str) -> list[Row]:
    env = registry.make(task, image_size=None)
    required_rate = LEAST_STEPS[env.task.suite]
    steps = _rate(_stepper(env, np.random.default_rng(0)), TIMED)
    renderer = Renderer(env.model, camera=env.task.code().CAMERA, size=SIZE)
    frames = _rate(lambda: renderer.render(env.data), FRAMES)
    faults, growth = _soundness(env)
    solved = sum(_episode(env, seed) for seed in range(EPISODES))
    name = f"dexterous/{task}"
    return [
        Row(
            name=f"{name}: speed",
            value=steps,
            unit="steps/s",
            ratio=None,
            target=f">= {required_rate:.0f}",
            met=steps >= required_rate,
        ),
        Row(
            name=f"{name}: pictures",
            value=frames,
            unit="frames/s",
            ratio=None,
            target=f">= {LEAST_FRAMES:.0f}",
            met=frames >= LEAST_FRAMES,
        ),
        Row(
            name=f"{name}: faults in {STEPS:,} steps",
            value=faults,
            unit="warnings or NaN",
            ratio=None,
            target="0",
            met=faults == 0,
        ),
        Row(
            name=f"{name}: memory grown in {STEPS:,} steps",
            value=growth,
            unit="MB",
            ratio=None,
            target=f"< {MOST_GROWTH:.0f}",
            met=growth < MOST_GROWTH,
        ),
        Row(
            name=f"{name}: random policy",
            value=solved,
            unit=f"of {EPISODES} solved",
            ratio=None,
            target="0",
            met=solved == 0,
        ),
    ]


def _rate(call: Callable[[], object], count: int) -> float:
    """Calls per second of processor time, which other processes disturb less than wall time."""
    for _ in range(CHUNK):
        call()
    seconds = []
    for _ in range(count // CHUNK):
        started = time.process_time()
        for _ in range(CHUNK):
            call()
        seconds.append(time.process_time() - started)
    return CHUNK / statistics.median(seconds)


def _stepper(env: DexterousTask, rng: np.random.Generator, extreme: bool = False) -> Callable[[], bool]:
    """A function that executes a step of random actions, or of random extreme actions, and returns whether it was
    sound.

    Episodes restart automatically.
    """
    seeds = iter(range(2**31))
    env.reset(seed=next(seeds))

    def step() -> bool:
        action = rng.uniform(-1, 1, env.action_space.shape)
        obs, _, terminated, truncated, _ = env.step(np.sign(action) if extreme else action)
        sound = np.isfinite(obs["state"]).all() and not env.data.warning.number.any()
        if terminated or truncated:
            env.reset(seed=next(seeds))
        return bool(sound)

    return step


def _soundness(env: DexterousTask) -> tuple[int, float]:
    """Number of steps with a warning of the simulator or a NaN, and growth of memory in MB."""
    faults, settled = 0, 0
    for extreme in (False, True):
        step = _stepper(env, np.random.default_rng(1), extreme)
        for t in range(STEPS // 2):
            faults += not step()
            if t == SETTLED and not extreme:
                settled = _peak()
    return faults, (_peak() - settled) / 1024


def _peak() -> int:
    """Peak memory of the process in kB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


def _episode(env: DexterousTask, seed: int) -> bool:
    """Whether an episode of random actions is ever solved."""
    rng = np.random.default_rng(seed)
    env.reset(seed=seed)
    ended = False
    while not ended:
        _, _, terminated, truncated, info = env.step(rng.uniform(-1, 1, env.action_space.shape))
        ended = terminated or truncated
    return info["success"]["once"]


if __name__ == "__main__":
    for row in run(sys.argv[1:] or TASKS):
        print(
            f"{row['name']:<62}{row['value']:>9.4g} {row['unit']:<16} target {row['target']:<8} "
            f"{'yes' if row['met'] else 'NO'}"
        )
