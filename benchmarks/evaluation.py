"""Cost of the parts of an evaluation step, in one thread: `python -m benchmarks.evaluation`."""

import statistics
import time

import numpy as np
import torch

from acgd.evaluation.settings import EvaluationConfig
from acgd.simulate.lockstep import Lockstep
from acgd.simulate.policy import Policy
from acgd.simulate.roll import Recorder, Step, roll
from acgd.students.acgd.settings import ACGDConfig
from acgd.students.load import new_student, policy_of
from acgd.students.settings import ActingConfig, ImitationConfig
from acgd.students.student import Sizes
from acgd.tasks.settings import ImageConfig, TaskConfig
from acgd.vision.cnn import SmallCNN
from acgd.vision.privileged.settings import PrivilegedConfig
from benchmarks.row import Row

TASK = TaskConfig(name="myo/key-turn")
STEPS = 60
"""Steps of an episode. The median step counts."""


def run() -> list[Row]:
    """Environment steps per second: physics alone, with images, and with an untrained student of the default size."""
    torch.set_num_threads(1)
    size, pixels = EvaluationConfig().lockstep, ImageConfig().size
    blind, seeing = Lockstep(TASK, size, image_size=None), Lockstep(TASK, size, image_size=pixels)
    proprio, actions = (seeing.envs[0].observation_space["proprio"].shape[0], seeing.envs[0].action_space.shape[0])
    features = PrivilegedConfig().dim
    sizes = Sizes(features, proprio, actions, tasks=3, owns_cnn=False)
    student = new_student(ACGDConfig(), ImitationConfig(), sizes).eval()
    acting = policy_of(student, SmallCNN(features).eval(), ActingConfig(), tasks=(TASK.name,), rows=size)
    still, goals = Still(actions), np.zeros((size, pixels, pixels, 3), np.uint8)
    rates = {
        "physics alone": _steps_per_s(blind, size, still),
        "with images": _steps_per_s(seeing, size, still),
        f"with images and a student, {size} in lockstep": _steps_per_s(seeing, size, Still(actions, acting), goals),
    }
    physics = rates["physics alone"]
    return [
        Row(name=f"evaluation/{name}", value=rate, unit="steps/s", ratio=rate / physics, target="", met=None)
        for name, rate in rates.items()
    ]


class Still:
    """Holds still, and evaluates `policy` without its actions. An untrained student would end episodes early."""

    def __init__(self, actions: int, policy: Policy | None = None) -> None:
        self.actions, self.policy = actions, policy

    def start(self, tasks: np.ndarray, goals: np.ndarray | None, seeds: list[int]):
        return self.policy.start(tasks, goals, seeds) if self.policy else None

    def act(self, observations: dict[str, np.ndarray], memory):
        if self.policy:
            _, memory = self.policy.act(observations, memory)
        return np.full((len(observations["state"]), self.actions), -0.9, np.float32), memory


class Clock(Recorder):
    """Records seconds per environment step, from the end of one step to the end of the next."""

    def start(self, lock: Lockstep, seeds: list[int]) -> None:
        self.times: list[float] = []
        self.last = time.perf_counter()

    def after(self, lock: Lockstep, step: Step) -> None:
        now = time.perf_counter()
        self.times.append((now - self.last) / len(step.running))
        self.last = now


def _steps_per_s(lock: Lockstep, size: int, policy: Policy, goals: np.ndarray | None = None) -> float:
    """Rate of the median step of all environments."""
    clock = Clock()
    roll(lock, policy, range(size), goals=goals, limits=np.full(size, STEPS), recorders=[clock])
    return 1 / statistics.median(clock.times)


def main() -> None:
    for row in run():
        print(f"{row['name']:<60}{row['value']:>8.0f} {row['unit']}{row['ratio']:>7.2f} of physics alone")


if __name__ == "__main__":
    main()
