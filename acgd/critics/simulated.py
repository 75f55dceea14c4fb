"""Environments for the simulation of an expert, and transitions that are simulated once per artifact."""

from collections.abc import Callable
from pathlib import Path

from acgd.critics.transitions import Transitions
from acgd.experts.policy import Expert
from acgd.simulate.lockstep import Lockstep
from acgd.store.atomic import replace_file
from acgd.tasks.settings import TaskConfig

ENVIRONMENTS = 8
"""Environments in one process: enough to batch the expert, and few enough to construct quickly."""


def lockstep(task: TaskConfig, expert: Expert) -> Lockstep:
    """Environments with the reward weights of the expert's training, without images."""
    return Lockstep(task, ENVIRONMENTS, image_size=None, reward_weights=expert.meta["reward_weights"])


def simulated_once(state: Path, simulate: Callable[[], Transitions]) -> Transitions:
    """Returns the result of `simulate`, and stores it in the folder `state`.

    A stage that resumes after a kill loads the stored transitions.
    """
    file = state / "transitions.safetensors"
    if not file.exists():
        data = simulate()
        replace_file(file, data.save)
    return Transitions.load(file)
