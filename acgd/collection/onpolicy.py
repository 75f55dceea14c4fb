"""The stage `onpolicy`: episodes of a mixture of student and expert (DAgger, Ross et al. 2011)."""

import json
from functools import cache

import numpy as np

from acgd.collection.settings import OnPolicyRequest
from acgd.collection.waves import StoredEpisode, steps, wave, write_rollouts
from acgd.evaluation.goals import training_goals
from acgd.experts.policy import Expert
from acgd.simulate.lockstep import Lockstep
from acgd.simulate.policy import Mean, Mixture, Padded, Policy
from acgd.simulate.record import Episode, Episodes
from acgd.simulate.roll import Goals, Step, roll
from acgd.simulate.seeds import round_seeds
from acgd.store.stage import Context, Inputs
from acgd.students.load import load_policy

LOCKSTEP = 10
"""Episodes in lockstep, and rows of every computation of student and expert."""


def collect(request: OnPolicyRequest, inputs: Inputs, ctx: Context) -> None:
    """Runs the mixture on the seeds of one round and task. Keeps every episode, solved or not.

    In each step the expert's mean acts with probability beta ** round, else the student. Writes rollouts.zarr with the
    arrays of demonstrations and `by_expert` (docs/rollouts.md), and summary.json. The goals are those of an
    evaluation: commanded goals for `imitation.goal: vector`, else last frames of demonstrations, chosen by the seed.
    Each finished wave is saved.
    """
    rounds = request.rounds
    expert = Expert.load(inputs["expert"])
    seeds = round_seeds(request.seed, request.round, rounds.episodes)
    label = f"on-policy round {request.round}, {request.task.name}"

    @cache
    def runner():
        """The function that runs a wave. Made only if a wave is missing: loading student and environments is slow."""
        student = load_policy(
            inputs["student"], inputs["backbone"], request.acting, ctx.device, LOCKSTEP, weights="last"
        )
        weights = expert.meta["reward_weights"]
        lock = Lockstep(request.task, min(LOCKSTEP, len(seeds)), image_size=request.image.size, reward_weights=weights)
        task = student.tasks.index(request.task.name)
        chance = rounds.beta**request.round

        def goals(wave_seeds: list[int]) -> Goals:
            return Lockstep.goal_vectors if student.goal == "vector" else training_goals(inputs["rollouts"], wave_seeds)

        return lambda wave_seeds: run_wave(
            expert, student, lock, wave_seeds, task, goals(wave_seeds), chance, labels=rounds.labels == "expert"
        )

    episodes: list[StoredEpisode] = []
    with ctx.progress(len(seeds), label) as bar:
        for first in range(0, len(seeds), LOCKSTEP):
            batch = seeds[first : first + LOCKSTEP]
            episodes += wave(ctx.state, batch, lambda wave_seeds: runner()(wave_seeds))
            bar.update(len(batch), successes=sum(bool(episode["success_final"]) for episode in episodes))
    write_rollouts(ctx.out, request.task, episodes)
    content = _summary(request, episodes)
    (ctx.out / "summary.json").write_text(json.dumps(content, indent=1, sort_keys=True) + "\n")


def run_wave(
    expert: Expert,
    student: Policy,
    lock: Lockstep,
    seeds: list[int],
    task: int,
    goals: Goals,
    chance: float,
    *,
    labels: bool,
) -> list[Episode]:
    """Runs the episodes of `seeds`. Returns all of them in this order.

    task: task id of the student. chance: probability in each step that the expert acts. labels: whether to store the
    expert's mean in every visited state as `mean_action`.
    """
    means = Padded(Mean(expert), LOCKSTEP)

    def extra_arrays(step: Step) -> dict[str, np.ndarray]:
        recorded = {"by_expert": step.memory.by_first}
        if labels:
            recorded["mean_action"] = means.act({"state": step.observations["state"]}, None)[0]
        return recorded

    recorder = Episodes(extra_arrays)
    roll(lock, Mixture(means, student, chance), seeds, task=task, goals=goals, recorders=[recorder])
    return recorder.episodes()


def _summary(request: OnPolicyRequest, episodes: list[StoredEpisode]) -> dict:
    """Content of summary.json. expert_queries: number of states whose expert action was stored or executed."""
    successes = sum(bool(episode["success_final"]) for episode in episodes)
    by_expert = sum(int(episode["by_expert"].sum()) for episode in episodes)
    return {
        "round": request.round,
        "episodes": len(episodes),
        "failures": len(episodes) - successes,
        "success": successes / len(episodes),
        "environment_steps": steps(episodes),
        "steps_by_expert": by_expert,
        "expert_queries": steps(episodes) if request.rounds.labels == "expert" else by_expert,
        "mean_return": float(np.mean([episode["reward"].sum() for episode in episodes])),
    }
