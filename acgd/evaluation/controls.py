"""The stage `controls`: what recordings and the expert do from a student's starts.

A task that replay solves needs neither vision nor feedback; the expert is the upper bound. Episodes have the same seeds
as a student's, so that they pair.
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
"""Name -> its policy. `expert-nominal` starts from the suite's nominal start, which on a Fixed task is one episode; the
others start as the task says."""


def controls(request: ControlsRequest, inputs: Inputs, ctx: Context) -> None:
    """Runs every control on every task: episodes.jsonl and summary.json, in the format of an evaluation."""
    settings, size = request.controls, request.controls.lockstep
    ctx.metrics.rewind(-1)
    chosen = [
        (place, start, names, seeds_of(start, settings.split, settings.episodes, settings.seed_offset))
        for place, task in enumerate(request.tasks)
        for start, names in _starts(task)
    ]
    episodes: list[Episode] = []
    with ctx.progress(sum(len(names) * len(seeds) for _, _, names, seeds in chosen), "controls") as bar:
        for place, start, names, seeds in chosen:
            demonstrations = Demonstrations.load(inputs["rollouts"][place], ["action", "state"])
            expert = Expert.load(inputs["expert"][place])
            lock = Lockstep(start, size, image_size=None)
            for name in names:
                label = Label(name, start.name, "none", "none", start.start)
                policy = CONTROLS[name](demonstrations, expert, size)
                episodes += run(lock, seeds, policy, label, ctx.state, bar)[0]
            del lock  # before the next one is made: an environment is some 50 MB
    write(ctx.out / "episodes.jsonl", episodes)
    about = {"split": settings.split, "seed_offset": settings.seed_offset}
    rows = write_summary(ctx.out / "summary.json", episodes, **about)
    ctx.metrics.log(0, **{f"{row['control']}/{row['task']}/{row['rule']}": row["rate"] for row in rows})


def _starts(task: TaskConfig) -> Iterator[tuple[TaskConfig, list[str]]]:
    """The starts of a task's controls, and the controls that begin there."""
    nominal = task.model_copy(update={"start": "nominal"})
    if task == nominal:
        yield task, list(CONTROLS)
        return
    yield task, [name for name in CONTROLS if name != "expert-nominal"]
    yield nominal, ["expert-nominal"]


def replay(demonstrations: Demonstrations) -> Policy:
    """The actions of a demonstration that the episode's seed chooses. Blind: it reads no observation."""
    count = len(demonstrations.seeds)
    return Replay(
        demonstrations.arrays["action"],
        demonstrations.episode_ends,
        lambda observations, seeds: [demonstration_for(seed, count) for seed in seeds],
    )


def replay_nearest(demonstrations: Demonstrations) -> Policy:
    """The actions of the demonstration whose first state is nearest to the episode's.

    Not blind: it reads the privileged state of the start. It has no feedback after that.
    """
    starts = demonstrations.arrays["state"][demonstrations.episode_starts]

    def choose(observations: Observations, seeds: list[int]) -> np.ndarray:
        return nearest(observations["state"], starts)

    return Replay(demonstrations.arrays["action"], demonstrations.episode_ends, choose)


def nearest(states: np.ndarray, starts: np.ndarray) -> np.ndarray:
    """(m,): which of `starts` (E, S) is nearest to each of `states` (m, S).

    The unit of an entry is its standard deviation over the starts. Entries that all starts share do not count.
    """
    spread = starts.std(axis=0)
    varied = spread > 1e-6
    scaled = (states[:, None, varied] - starts[None, :, varied]) / spread[varied]
    return np.square(scaled).sum(axis=-1).argmin(axis=1)
