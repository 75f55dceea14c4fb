"""What an evaluation's time goes into, step by step, in one thread: `python -m benchmarks.evaluation`."""

import statistics
import time
from collections.abc import Callable

import numpy as np
import torch

from acgd.evaluation.evaluate import StudentPolicy
from acgd.evaluation.settings import EvaluationConfig
from acgd.simulate.lockstep import Lockstep
from acgd.students.acting import Actor
from acgd.students.codebook import Sizes
from acgd.students.settings import ActingConfig, CodebookConfig
from acgd.students.student import Student
from acgd.tasks.settings import TaskConfig
from acgd.vision.cnn import SmallCNN
from acgd.vision.settings import BackboneConfig
from benchmarks.row import Row

TASK = TaskConfig(name="myo/key-turn")
STEPS = 60
"""Of an episode; the median one counts."""


def run() -> list[Row]:
    """Environment steps per second: physics alone, with images, and with an untrained student of the default size acting on them."""
    torch.set_num_threads(1)
    size = EvaluationConfig().lockstep
    seeds = list(range(size))
    blind, seeing = Lockstep(TASK, size, image_size=None), Lockstep(TASK, size, image_size=84)
    proprio, actions = (seeing.envs[0].observation_space["proprio"].shape[0], seeing.envs[0].action_space.shape[0])
    features = BackboneConfig().dim
    student = Student(CodebookConfig(), Sizes(features, proprio, actions, tasks=3, owns_cnn=False))
    actor = Actor(student, SmallCNN(features).eval(), ActingConfig())
    goals = np.zeros((size, TASK.image_size, TASK.image_size, 3), np.uint8)
    policy = StudentPolicy(actor, 0, seeds, goals, size, shuffled=False)
    still = np.full((size, actions), -0.9, np.float32)
    physics = _steps_per_s(blind, seeds, lambda obs, step: still)
    images = _steps_per_s(seeing, seeds, lambda obs, step: still)

    def student_and_still(obs: dict[str, np.ndarray], step: int) -> np.ndarray:
        policy(
            obs, step
        )  # an untrained student would drop the object: it costs what a trained one does, and has no say
        return still

    acting = _steps_per_s(seeing, seeds, student_and_still)
    rates = {"physics alone": physics, "with images": images, f"with images and a student, {size} in lockstep": acting}
    return [
        Row(name=f"evaluation/{name}", value=rate, unit="steps/s", ratio=rate / physics, target="", met=None)
        for name, rate in rates.items()
    ]


def _steps_per_s(lock: Lockstep, seeds: list[int], policy: Callable[[dict[str, np.ndarray], int], np.ndarray]) -> float:
    """Rate of the median step of all environments."""
    obs, times = lock.reset(seeds), []
    for step in range(STEPS):
        active, start = int(lock.active.sum()), time.perf_counter()
        obs, *_ = lock.step(policy(obs, step))
        times.append((time.perf_counter() - start) / active)
        if not lock.active.any():
            break
    return 1 / statistics.median(times)


def main() -> None:
    for row in run():
        print(f"{row['name']:<60}{row['value']:>8.0f} {row['unit']}{row['ratio']:>7.2f} of physics alone")


if __name__ == "__main__":
    main()
