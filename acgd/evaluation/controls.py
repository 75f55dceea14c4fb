"""The stage `controls`: success of replayed demonstrations and of the expert from a student's starts.

A task that replay solves needs neither vision nor feedback. The expert is the upper bound. The episodes have the same
seeds as a student's episodes, so that they can be paired.
"""

from collections.abc import Callable, Iterator

import numpy as np

from acgd.evaluation.episodes import Episode, Label, run, seeds_of, write
from acgd.evaluation.goals import demonstration_for
from acgd.evaluation.settings import ControlsRequest
from acgd.evaluation.summary import write_summary
from acgd.experts.policy import Expert
from acgd.rollouts.dataset import Demonstrations
from acgd.simulate.lockstep import Lockstep
from acgd.simulate.policy import Mean, Observations, Padded, Policy, Replay
from acgd.store.stage import Context, Inputs
from acgd.tasks.settings import TaskConfig

CONTROLS: dict[str, Callable[[Demonstrations, Expert, int], Policy]] = {
    "replay": lambda demonstrations, expert, size: replay(demonstrations),
    "replay-nearest": lambda demonstrations, expert, size: replay_nearest(demonstrations),
    "expert": lambda demonstrations, expert, size: Padded(Mean(expert), size),
    "expert-nominal": lambda demonstrations, expert, size: Padded(Mean(expert), size),
}
"""Name -> function (demonstrations, expert, lockstep) that makes the control's policy.

`expert-nominal` begins at the suite's nominal start, which is one episode on a Fixed task. The other controls begin at
the task's start.
"""


def controls(request: ControlsRequest, inputs: Inputs, ctx: Context) -> None:
    """Runs every control on every task. Writes episodes.jsonl and summary.json in the format of an evaluation."""
    settings, size = request.controls, request.controls.lockstep
    ctx.metrics.rewind(-1)
    groups = [
        (index, start, names, seeds_of(start, settings.split, settings.episodes, settings.seed_offset))
        for index, task in enumerate(request.tasks)
        for start, names in _starts(task)
    ]
    episodes: list[Episode] = []
    with ctx.progress(sum(len(names) * len(seeds) for _, _, names, seeds in groups), "controls") as bar:
        for index, start, names, seeds in groups:
            demonstrations = Demonstrations.load(inputs["rollouts"][index], ["action", "state"])
            expert = Expert.load(inputs["expert"][index])
            lock = Lockstep(start, size, image_size=None)
            for name in names:
                label = Label(name, start.name, "none", "none", start.start)
                policy = CONTROLS[name](demonstrations, expert, size)
                episodes += run(lock, seeds, policy, label, ctx.state, bar)[0]
            del lock  # frees memory before the next Lockstep: an environment takes some 50 MB
    write(ctx.out / "episodes.jsonl", episodes)
    about = {"split": settings.split, "seed_offset": settings.seed_offset}
    rows = write_summary(ctx.out / "summary.json", episodes, **about)
    ctx.metrics.log(0, **{f"{row['control']}/{row['task']}/{row['rule']}": row["rate"] for row in rows})


def _starts(task: TaskConfig) -> Iterator[tuple[TaskConfig, list[str]]]:
    """(start, controls) of a task: each start, and the names of the controls that begin there."""
    nominal = task.model_copy(update={"start": "nominal"})
    if task == nominal:
        yield task, list(CONTROLS)
        return
    yield task, [name for name in CONTROLS if name != "expert-nominal"]
    yield nominal, ["expert-nominal"]


def replay(demonstrations: Demonstrations) -> Policy:
    """A policy that replays the demonstration chosen by the episode's seed. It reads no observation."""
    count = len(demonstrations.seeds)
    return Replay(
        demonstrations.arrays["action"],
        demonstrations.episode_ends,
        lambda observations, seeds: [demonstration_for(seed, count) for seed in seeds],
    )


def replay_nearest(demonstrations: Demonstrations) -> Policy:
    """A policy that replays the demonstration whose first state is nearest to the episode's first state.

    It reads the privileged state at the start, and no observation after that.
    """
    starts = demonstrations.arrays["state"][demonstrations.episode_starts]

    def choose(observations: Observations, seeds: list[int]) -> np.ndarray:
        return nearest(observations["state"], starts)

    return Replay(demonstrations.arrays["action"], demonstrations.episode_ends, choose)


def nearest(states: np.ndarray, starts: np.ndarray) -> np.ndarray:
    """Index (m,) of the row of `starts` (E, S) that is nearest to each row of `states` (m, S).

    Each entry is divided by its standard deviation over the starts. Entries that are constant over the starts are
    ignored.
    """
    spread = starts.std(axis=0)
    varied = spread > 1e-6
    scaled = (states[:, None, varied] - starts[None, :, varied]) / spread[varied]
    return np.square(scaled).sum(axis=-1).argmin(axis=1)
