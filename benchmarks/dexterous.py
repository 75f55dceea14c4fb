"""BiDex and OpDex in one thread: speed, soundness under random and extreme actions, and that chance solves nothing:
`python -m benchmarks.dexterous`, or with names of tasks."""

import resource
import statistics
import sys
import time
from collections.abc import Callable, Sequence

import numpy as np
from acgd.tasks.cameras import CAMERAS

from acgd.tasks import registry
from acgd.tasks.dexterous import DexterousTask
from acgd.tasks.rendering import Renderer
from benchmarks.row import Row

TASKS = tuple(name for name, spec in registry.TASKS.items() if spec.suite in ("bidex", "opdex"))
LEAST_STEPS = {"bidex": 1000.0, "opdex": 2500.0}
LEAST_FRAMES = 250.0
SIZE = 84
CHUNK = 50
"""Steps or frames between two looks at the clock; the median chunk counts."""
TIMED = 2000
STEPS, FRAMES = 100_000, 400
"""Of the soundness, half of them random and half extreme; and of the speed of pictures."""
SETTLED = 5_000
"""Steps after which memory must not grow."""
MOST_GROWTH = 2.0
"""MB: a few pages of the allocator's."""
EPISODES = 50


def run(tasks: Sequence[str] = TASKS) -> list[Row]:
    """Five rows per task."""
    return [row for task in tasks for row in _measure(task)]


def _measure(task: str) -> list[Row]:
    env = registry.make(task, image_size=None)
    required_rate = LEAST_STEPS[env.task.suite]
    steps = _rate(_stepper(env, np.random.default_rng(0)), TIMED)
    renderer = Renderer(env.model, camera=CAMERAS[env.task.kind], size=SIZE)
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
    """Calls per second of processor time, so that other work on the machine counts for less."""
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
    """A step of random actions, or of the ends of their range; tells whether it was sound. Episodes begin anew by
    themselves."""
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
    """Steps with a warning of the simulator or a number that is none, and by how many MB memory grew."""
    faults, settled = 0, 0
    for extreme in (False, True):
        step = _stepper(env, np.random.default_rng(1), extreme)
        for t in range(STEPS // 2):
            faults += not step()
            if t == SETTLED and not extreme:
                settled = _peak()
    return faults, (_peak() - settled) / 1024


def _peak() -> int:
    """kB of memory at most so far."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


def _episode(env: DexterousTask, seed: int) -> bool:
    """Whether random actions ever solve it."""
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
