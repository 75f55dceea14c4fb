"""The stage `evaluation`: a student on held-out seeds, task by task, under each condition."""

from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from acgd.evaluation.clips import film, filming
from acgd.evaluation.episodes import Episode, Label, Policy, padded, run, seeds_of, write
from acgd.evaluation.goals import oracle_goals, training_goals
from acgd.evaluation.settings import EvaluationRequest
from acgd.evaluation.summary import RULES, write_summary
from acgd.experts.policy import Expert
from acgd.simulate.lockstep import Lockstep
from acgd.store.progress import Bar
from acgd.store.stage import Context, Inputs
from acgd.students import load as load_student
from acgd.students.acting import Actor
from acgd.tasks.settings import TaskConfig
from acgd.tasks.spec import TASKS
from acgd.vision.backbones import load as load_backbone


@dataclass(frozen=True)
class Round:
    """One task under one condition."""

    place: int
    """Task id: the task's place in the study."""
    task: TaskConfig
    """With the start that the condition asks for."""
    label: Label
    seeds: tuple[int, ...]


def evaluate(config: EvaluationRequest, inputs: Inputs, ctx: Context) -> None:
    """Runs every condition on every task: episodes.jsonl (the headline condition first), summary.json, clips/."""
    settings = config.evaluation
    student = load_student(inputs["student"], weights=settings.weights, device=ctx.device)
    backbone = None if student.sizes.owns_cnn else load_backbone(inputs["backbone"], ctx.device)
    actor = Actor(student, backbone, settings.acting)
    rounds = plan(config, uses_goal=student.config.goal_image != "off")
    headline = rounds[: len(config.tasks)]
    ctx.metrics.rewind(-1)
    episodes: dict[Round, list[Episode]] = {}
    with ctx.progress(sum(len(r.seeds) for r in rounds), "evaluating") as bar:
        for start in dict.fromkeys(r.task for r in rounds):
            here = [r for r in rounds if r.task == start]
            for this, (ended, actions) in zip(
                here, _act(actor, here, inputs, settings.lockstep, ctx.state, bar), strict=True
            ):
                episodes[this] = ended
                if settings.clips and this in headline:
                    film_both(ctx.out / "clips", start, ended, actions)
    everything = [episode for this in rounds for episode in episodes[this]]
    write(ctx.out / "episodes.jsonl", everything)
    rows = write_summary(
        ctx.out / "summary.json",
        everything,
        student_seed=config.seed,
        split=settings.split,
        acting=settings.acting.model_dump(),
    )
    ctx.metrics.log(0, **{f"{row['task']}/{row['rule']}": row["rate"] for row in rows[: len(headline) * len(RULES)]})


def plan(config: EvaluationRequest, *, uses_goal: bool) -> list[Round]:
    """The rounds in the order of the conditions; conditions that differ only by a goal that the student ignores are one."""
    settings, rounds = config.evaluation, {}
    for condition in settings.conditions:
        for place, task in enumerate(config.tasks):
            start = task if condition.start is None else task.model_copy(update={"start": condition.start})
            label = Label(
                "none", task.name, condition.goal if uses_goal else "none", condition.image_features, start.start
            )
            if label not in rounds:
                rounds[label] = Round(place, start, label, tuple(seeds_of(start, settings.split, settings.episodes)))
    return list(rounds.values())


def _act(
    actor: Actor, rounds: list[Round], inputs: Inputs, size: int, state: Path, bar: Bar
) -> list[tuple[list[Episode], dict[int, np.ndarray]]]:
    """Episodes and actions of rounds from one start. Its environments, some 0.1 GB each, live no longer than this call."""
    goals = [goal_images(this, inputs, size) for this in rounds]
    lock = Lockstep(rounds[0].task, size, image=True)

    def policy(this: Round, images: np.ndarray | None, batch: list[int]) -> Policy:
        mine = None if images is None else images[[this.seeds.index(seed) for seed in batch]]
        return StudentPolicy(actor, this.place, batch, mine, size, shuffled=this.label.image_features == "shuffled")

    return [
        run(lock, list(this.seeds), partial(policy, this, images), this.label, state, bar)
        for this, images in zip(rounds, goals, strict=True)
    ]


class StudentPolicy:
    """The student on one batch of episodes. It passes on `image` and `proprio`, and nothing else."""

    def __init__(
        self, actor: Actor, task_id: int, seeds: list[int], goals: np.ndarray | None, size: int, *, shuffled: bool
    ) -> None:
        """goals: (m, H, W, 3) or None. size: rows of every computation. shuffled: each episode sees the next one's image."""
        self.actor, self.size, self.shuffled = actor, size, shuffled
        rows = padded(np.asarray(seeds, np.int64), size)
        self.memory = actor.reset(np.full(size, task_id), None if goals is None else padded(goals, size), rows.tolist())

    def __call__(self, obs: dict[str, np.ndarray], step: int) -> np.ndarray:
        """(m, A) for stacked observations of m <= size episodes."""
        image = np.roll(obs["image"], -1, axis=0) if self.shuffled else obs["image"]
        seen = {"image": padded(image, self.size), "proprio": padded(obs["proprio"], self.size)}
        actions, self.memory = self.actor.act(seen, self.memory)
        return actions[: len(image)]


def goal_images(this: Round, inputs: Inputs, size: int) -> np.ndarray | None:
    """The goal images (E, H, W, 3) uint8 of a round's seeds, or None for a student without a goal."""
    if this.label.goal == "training":
        return training_goals(inputs["rollouts"][this.place], this.seeds)
    if this.label.goal == "oracle":
        return oracle_goals(this.task, Expert.load(inputs["experts"][this.place]), this.seeds, size)
    return None


def film_both(folder: Path, task: TaskConfig, episodes: list[Episode], actions: dict[int, np.ndarray]) -> None:
    """A clip of the first `final` success and one of the first failure, where there is one."""
    camera = filming(task)
    for name, wanted in (("success", True), ("failure", False)):
        episode = next((e for e in episodes if e.final == wanted), None)
        if episode is not None:
            film(folder / f"{TASKS[task.name].slug}-{name}.mp4", camera, episode, actions[episode.seed])
