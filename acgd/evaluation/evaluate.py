"""The stage `evaluation`: episodes of a student on held-out seeds, under one condition."""

import numpy as np

from acgd.evaluation.episodes import Episode, Label, run, seeds_of, write, write_actions
from acgd.evaluation.goals import oracle_goals, training_goals
from acgd.evaluation.settings import EvaluationRequest
from acgd.evaluation.summary import write_summary
from acgd.experts.policy import Expert
from acgd.simulate.lockstep import Lockstep
from acgd.simulate.policy import Policy, ShuffledImages
from acgd.simulate.roll import Goals
from acgd.store.stage import Context, Inputs
from acgd.students.load import load_policy
from acgd.tasks.settings import TaskConfig


def evaluate(request: EvaluationRequest, inputs: Inputs, ctx: Context) -> None:
    """Runs the episodes of every task. Writes episodes.jsonl, summary.json and actions.safetensors.

    actions.safetensors holds the actions of the first success and the first failure of each task.
    """
    settings, condition, size = request.evaluation, request.condition, request.evaluation.lockstep
    student = load_policy(
        inputs["student"], inputs["backbone"], request.acting, ctx.device, size, weights=settings.weights
    )
    policy: Policy = student
    if condition.image_features == "shuffled":
        policy = ShuffledImages(policy)
    starts = [
        task if condition.start is None else task.model_copy(update={"start": condition.start})
        for task in request.tasks
    ]
    seeds = [seeds_of(start, settings.split, settings.episodes, settings.seed_offset) for start in starts]
    ctx.metrics.rewind(-1)
    episodes: list[Episode] = []
    filmed: list[tuple[Episode, np.ndarray]] = []
    with ctx.progress(sum(map(len, seeds)), "evaluating") as bar:
        for index, start in enumerate(starts):
            goals = goals_of(request, inputs, index, start, seeds[index])
            lock = Lockstep(start, size, image_size=request.image.size)
            label = Label("none", start.name, condition.goal, condition.image_features, start.start)
            task = student.tasks.index(start.name)
            task_episodes, actions = run(lock, seeds[index], policy, label, ctx.state, bar, task=task, goals=goals)
            del lock  # frees memory before the next Lockstep: an environment takes some 0.1 GB
            episodes += task_episodes
            filmed += [(episode, actions[episode.seed]) for episode in first_of_each_outcome(task_episodes)]
    write(ctx.out / "episodes.jsonl", episodes)
    write_actions(ctx.out / "actions.safetensors", filmed)
    rows = write_summary(
        ctx.out / "summary.json",
        episodes,
        student_seed=request.seed,
        split=settings.split,
        seed_offset=settings.seed_offset,
        condition=condition.model_dump(),
        acting=request.acting.model_dump(),
    )
    ctx.metrics.log(0, **{f"{row['task']}/{row['rule']}": row["rate"] for row in rows})


def goals_of(request: EvaluationRequest, inputs: Inputs, index: int, start: TaskConfig, seeds: list[int]) -> Goals:
    """Goals of a task's seeds: images (E, H, W, 3) uint8, commanded goals, or None. index: the task's."""
    if request.condition.goal == "training":
        return training_goals(inputs["rollouts"][index], seeds)
    if request.condition.goal == "oracle":
        expert = Expert.load(inputs["expert"][index])
        return oracle_goals(start, expert, seeds, request.evaluation.lockstep, request.image.size)
    return Lockstep.goal_vectors if request.condition.goal == "commanded" else None


def first_of_each_outcome(episodes: list[Episode]) -> list[Episode]:
    """The first `final` success and the first failure, as far as the episodes have them."""
    firsts = (next((e for e in episodes if e.final == wanted), None) for wanted in (True, False))
    return [episode for episode in firsts if episode is not None]
