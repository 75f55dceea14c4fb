"""Searches the detour of a pose task (detours.py) by CMA-ES (Hansen and Ostermeier 2001), on training seeds:

    python -m acgd.experts.muscle.detour_search myo/pose-hard

A line a generation; the last one's detour and `rate` are what to write into detours.py and the recipe. An hour on one
core.
"""

import argparse
from collections.abc import Iterator
from dataclasses import dataclass

import cma
import numpy as np

from acgd.experts.muscle.control import MuscleControl
from acgd.experts.muscle.detours import CLENCHED, Detour
from acgd.experts.muscle.settings import ControllerSettings
from acgd.simulate.seeds import SEEDS
from acgd.tasks import registry
from acgd.tasks.myodex import MyoDexTask
from acgd.tasks.settings import TaskConfig

FIRST = {"posture": 0.0, "share": 1.3, "steps": 20.0, "gain": 3.0, "rate": 2.5}
"""Where the search begins: everything bent a third further than the goal asks."""
SPREAD = 0.3
"""Of the first generation: rad; tens of steps; of the logarithms of gain and rate."""
SOLVED, SOFT, FAR = 0.7, 0.1, 2.0
"""Rad: the suite's threshold for the norm of all joints' errors, how softly it counts, and beyond what an error is no
worse."""


@dataclass(frozen=True)
class Generation:
    """The centre of a generation's distribution."""

    number: int
    detour: Detour
    rate: float
    score: float
    """Of the generation's candidates, the mean; less is better."""


def search(
    task: str, settings: ControllerSettings, *, population: int = 16, episodes: int = 8, seed: int = 0
) -> Iterator[Generation]:
    """Generations of detours for a pose task, without end; `settings` but `rate` are the teacher's. Same seed, same
    detours."""
    env = registry.make(TaskConfig(name=task), image_size=None)
    if env.task.kind != "pose":
        raise ValueError(f"{task} has no detour, only pose tasks have: choose one of them")
    evolution = cma.CMAEvolutionStrategy(_vector(), SPREAD, {"seed": seed + 1, "popsize": population, "verbose": -9})
    rng, generation = np.random.default_rng(seed), 0
    while True:
        seeds = rng.integers(SEEDS.expert_training.start, SEEDS.expert_training.stop, episodes).tolist()
        candidates = evolution.ask()
        scores = [score(env, *_teacher(vector, settings), seeds) for vector in candidates]
        evolution.tell(candidates, scores)
        generation += 1
        detour, middle = _teacher(evolution.mean, settings)
        yield Generation(generation, detour, middle.rate, float(np.mean(scores)))


def score(env: MyoDexTask, detour: Detour, settings: ControllerSettings, seeds: list[int]) -> float:
    """Distance to the goal at the end, rad, plus 1 beyond SOLVED; the mean over `seeds`. Less is better."""
    teacher, errors = MuscleControl(env, settings, detour), []
    for seed in seeds:
        env.reset(seed=seed)
        ended = False
        while not ended:
            _, _, terminated, truncated, _ = env.step(teacher.action())
            ended = terminated or truncated
        errors.append(np.linalg.norm(env.base.target_jnt_value - env.data.qpos))
    errors = np.array(errors)
    return float(np.mean(np.minimum(errors, FAR) + 1 / (1 + np.exp((SOLVED - errors) / SOFT))))


def _vector() -> np.ndarray:
    """FIRST as the search sees it: (P,) of about one size."""
    joints = np.ones(len(CLENCHED))
    return np.concatenate(
        [
            FIRST["posture"] * joints,
            FIRST["share"] * joints,
            [FIRST["steps"] / 10],
            np.log([FIRST["gain"], FIRST["rate"]]),
        ]
    )


def _teacher(vector: np.ndarray, settings: ControllerSettings) -> tuple[Detour, ControllerSettings]:
    """The inverse: a detour, and the teacher's settings with its rate."""
    posture, share, (steps, gain, rate) = np.split(vector, [len(CLENCHED), 2 * len(CLENCHED)])
    detour = Detour(steps=max(0, round(10 * steps)), gain=float(np.exp(gain)), posture=posture, share=share)
    return detour, settings.model_copy(update={"rate": float(np.exp(rate))})


def main() -> None:
    """Print every generation until the last, or until it is interrupted."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("task", help="a pose task, such as myo/pose-hard")
    parser.add_argument("--generations", type=int, default=100)
    parser.add_argument(
        "--damping", type=float, default=0.3, help="of the teacher, as in the expert's settings of kind muscle"
    )
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    for centre in search(args.task, ControllerSettings(damping=args.damping), seed=args.seed):
        posture, share = (np.round(angles, 2).tolist() for angles in (centre.detour.posture, centre.detour.share))
        print(f"{centre.number}: score {centre.score:.3f}, rate {centre.rate:.2f}, steps {centre.detour.steps}, "
              f"gain {centre.detour.gain:.2f}, posture {posture}, share {share}", flush=True)  # fmt: skip
        if centre.number >= args.generations:
            return


if __name__ == "__main__":
    main()
