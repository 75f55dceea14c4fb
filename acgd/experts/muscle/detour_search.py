"""Search of a pose task's detour by CMA-ES (Hansen and Ostermeier 2001), on training seeds:

    python -m acgd.experts.muscle.detour_search myo/pose-hard

Prints one line per generation. The last line's detour belongs into detours.py, its `rate` into the expert's settings. A
search takes an hour on one core. Score: docs/method.md, "Detours of pose tasks".
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

INITIAL = {"posture": 0.0, "share": 1.3, "steps": 20.0, "gain": 3.0, "rate": 2.5}
"""Start of the search: all joints bent 30% further than the goal."""
SPREAD = 0.3
"""Standard deviation of the first generation, in rad, tens of steps, and logarithms of gain and rate."""
SOLVED, SOFT, FAR = 0.7, 0.1, 2.0
"""In rad: the suite's threshold of the norm of all joints' errors, the width of its soft count, and the largest error
that the score distinguishes."""


@dataclass(frozen=True)
class Generation:
    """The mean of a generation's distribution."""

    number: int
    detour: Detour
    rate: float
    score: float
    """Mean score of the generation's candidates; less is better."""


def search(
    task: str, settings: ControllerSettings, *, population: int = 16, episodes: int = 8, seed: int = 0
) -> Iterator[Generation]:
    """Yields generations of detours for a pose task, without end. The search is a function of `seed`.

    settings: those of the controller; the search replaces `rate`. ValueError for other kinds of tasks.
    """
    env = registry.make(TaskConfig(name=task), image_size=None)
    if env.task.kind != "pose":
        raise ValueError(f"{task} has no detour, only pose tasks have: choose one of them")
    evolution = cma.CMAEvolutionStrategy(
        _initial_vector(), SPREAD, {"seed": seed + 1, "popsize": population, "verbose": -9}
    )
    rng, generation = np.random.default_rng(seed), 0
    while True:
        seeds = rng.integers(SEEDS.expert_training.start, SEEDS.expert_training.stop, episodes).tolist()
        candidates = evolution.ask()
        scores = [score(env, *_decode(vector, settings), seeds) for vector in candidates]
        evolution.tell(candidates, scores)
        generation += 1
        detour, mean_settings = _decode(evolution.mean, settings)
        yield Generation(generation, detour, mean_settings.rate, float(np.mean(scores)))


def score(env: MyoDexTask, detour: Detour, settings: ControllerSettings, seeds: list[int]) -> float:
    """Mean over `seeds` of the final distance to the goal in rad, plus a soft 1 above SOLVED. Less is better."""
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


def _initial_vector() -> np.ndarray:
    """INITIAL as a vector (P,) of parameters of similar scale."""
    joints = np.ones(len(CLENCHED))
    return np.concatenate(
        [
            INITIAL["posture"] * joints,
            INITIAL["share"] * joints,
            [INITIAL["steps"] / 10],
            np.log([INITIAL["gain"], INITIAL["rate"]]),
        ]
    )


def _decode(vector: np.ndarray, settings: ControllerSettings) -> tuple[Detour, ControllerSettings]:
    """Parameters (P,) -> a detour, and the controller's settings with the searched rate."""
    posture, share, (steps, gain, rate) = np.split(vector, [len(CLENCHED), 2 * len(CLENCHED)])
    detour = Detour(steps=max(0, round(10 * steps)), gain=float(np.exp(gain)), posture=posture, share=share)
    return detour, settings.model_copy(update={"rate": float(np.exp(rate))})


def main() -> None:
    """Prints each generation."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("task", help="a pose task, such as myo/pose-hard")
    parser.add_argument("--generations", type=int, default=100)
    parser.add_argument(
        "--damping",
        type=float,
        default=0.3,
        help="damping of the controller, as in the expert's settings of kind muscle",
    )
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    for generation in search(args.task, ControllerSettings(damping=args.damping), seed=args.seed):
        posture, share = (
            np.round(angles, 2).tolist() for angles in (generation.detour.posture, generation.detour.share)
        )
        print(
            f"{generation.number}: score {generation.score:.3f}, rate {generation.rate:.2f}, "
            f"steps {generation.detour.steps}, gain {generation.detour.gain:.2f}, posture {posture}, share {share}",
            flush=True,
        )
        if generation.number >= args.generations:
            return


if __name__ == "__main__":
    main()
