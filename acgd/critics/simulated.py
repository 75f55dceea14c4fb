"""The environments that an expert is simulated in, and a simulation that a kill does not repeat."""

from collections.abc import Callable
from pathlib import Path

from acgd.critics.transitions import Transitions
from acgd.experts.policy import Expert
from acgd.simulate.lockstep import Lockstep
from acgd.store.atomic import replace_file
from acgd.tasks.settings import TaskConfig

ENVIRONMENTS = 8
"""Side by side in one process: enough to batch the expert, few enough to make."""


def lockstep(task: TaskConfig, expert: Expert) -> Lockstep:
    """Environments with the rewards that the expert was trained on."""
    return Lockstep(task, ENVIRONMENTS, image_size=None, reward_weights=expert.meta["reward_weights"])


def simulated_once(state: Path, simulate: Callable[[], Transitions]) -> Transitions:
    """What `simulate` returns. It is kept in the folder `state`, so that a stage that goes on after a kill does not
    simulate again."""
    kept = state / "transitions.safetensors"
    if not kept.exists():
        data = simulate()
        replace_file(kept, data.save)
    return Transitions.load(kept)
