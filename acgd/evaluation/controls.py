"""The stage `controls`: what replay, which sees nothing, and the expert, which sees all, do from a student's starts.

A task that replay solves needs neither vision nor feedback; the expert is the upper bound. Episodes are numbered by the
same seeds as a student's, so that they pair.
"""

import numpy as np

from acgd.evaluation.episodes import Episode, Label, Policy, expert_policy, run, seeds_of, write
from acgd.evaluation.goals import demonstration_for
from acgd.evaluation.settings import ControlsRequest
from acgd.evaluation.summary import write_summary
from acgd.experts.policy import Expert
from acgd.rollouts.dataset import Demonstrations
from acgd.simulate.lockstep import Lockstep
from acgd.store.stage import Context, Inputs

CONTROLS = ("replay", "replay-nearest", "expert", "expert-nominal")
"""A demonstration's actions open-loop; those of the demonstration with the nearest start; the expert's mean action, from
the same starts and from the suite's nominal one, which on a Fixed task is one episode."""


def controls(config: ControlsRequest, inputs: Inputs, ctx: Context) -> None:
    """Runs every control on every task: episodes.jsonl and summary.json, in the format of an evaluation."""
    settings, tasks, size = config.controls, config.tasks, config.controls.lockstep
    ctx.metrics.rewind(-1)
    starts = [
        [task.model_copy(update={"start": "nominal"}) if name == "expert-nominal" else task for name in CONTROLS]
        for task in tasks
    ]
    seeds = [[seeds_of(start, settings.split, settings.episodes) for start in row] for row in starts]
    episodes: list[Episode] = []
    with ctx.progress(sum(len(s) for row in seeds for s in row), "controls") as bar:
        for place in range(len(tasks)):
            demonstrations = Demonstrations.load(inputs["rollouts"][place], ["action", "state"])
            expert = Expert.load(inputs["experts"][place])
            for start in dict.fromkeys(starts[place]):
                lock = Lockstep(start, size, image=False)
                for name, chosen in (
                    (n, s) for n, at, s in zip(CONTROLS, starts[place], seeds[place], strict=True) if at == start
                ):
                    label = Label(name, start.name, "none", "none", start.start)
                    episodes += run(lock, chosen, _policies(name, demonstrations, expert, size), label, ctx.state, bar)[
                        0
                    ]
                del lock  # before the next one is made: an environment is some 50 MB
    write(ctx.out / "episodes.jsonl", episodes)
    rows = write_summary(ctx.out / "summary.json", episodes, split=settings.split)
    ctx.metrics.log(0, **{f"{row['control']}/{row['task']}/{row['rule']}": row["rate"] for row in rows})


def _policies(name: str, demonstrations: Demonstrations, expert: Expert, size: int):
    """Batch of seeds -> the policy of that control."""
    if name == "replay":
        return lambda batch: replay(
            demonstrations, [demonstration_for(seed, len(demonstrations.seeds)) for seed in batch]
        )
    if name == "replay-nearest":
        return lambda batch: NearestReplay(demonstrations)
    return lambda batch: expert_policy(expert, size)


def replay(demonstrations: Demonstrations, chosen: list[int]) -> Policy:
    """Row i executes the actions of demonstration chosen[i] whatever it sees, and at its end repeats the last."""
    first, last = demonstrations.episode_starts[chosen], demonstrations.episode_ends[chosen] - 1

    def act(obs: dict[str, np.ndarray], step: int) -> np.ndarray:
        return demonstrations.arrays["action"][np.minimum(first + step, last)]

    return act


class NearestReplay:
    """Replays, in each row, the demonstration whose first state is nearest to the episode's."""

    def __init__(self, demonstrations: Demonstrations) -> None:
        self.demonstrations = demonstrations

    def __call__(self, obs: dict[str, np.ndarray], step: int) -> np.ndarray:
        if step == 0:
            starts = self.demonstrations.arrays["state"][self.demonstrations.episode_starts]
            self.replay = replay(self.demonstrations, nearest(obs["state"], starts).tolist())
        return self.replay(obs, step)


def nearest(states: np.ndarray, starts: np.ndarray) -> np.ndarray:
    """(m,): which of `starts` (E, S) is nearest to each of `states` (m, S), in units of the standard deviation over starts.

    Entries that all starts share do not count.
    """
    spread = starts.std(axis=0)
    varied = spread > 1e-6
    scaled = (states[:, None, varied] - starts[None, :, varied]) / spread[varied]
    return np.square(scaled).sum(axis=-1).argmin(axis=1)
