"""The stage `onpolicy`: episodes that a student visits, in part steered by the expert (DAgger, Ross et al. 2011)."""

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
"""Episodes run side by side, and the rows of every computation of student and expert."""


def collect(request: OnPolicyRequest, inputs: Inputs, ctx: Context) -> None:
    """Run the mixture of one round and task on its seeds, and keep every episode, solved or not.

    In each step the expert's mean acts with probability beta ** round, else the student. Writes rollouts.zarr with the
    arrays of demonstrations and `by_expert` (docs/rollouts.md), and summary.json. Goals are those of an evaluation:
    commanded for a student of `imitation.goal: vector`, else ends of demonstrations, chosen by the seed. Finished waves
    survive a kill.
    """
    rounds = request.rounds
    expert = Expert.load(inputs["expert"])
    seeds = round_seeds(request.seed, request.round, rounds.episodes)
    label = f"on-policy round {request.round}, {request.task.name}"

    @cache
    def run_batch():
        """Made where a wave is missing: loading the student and making environments takes seconds."""
        student = load_policy(
            inputs["student"], inputs["backbone"], request.acting, ctx.device, LOCKSTEP, weights="last"
        )
        weights = expert.meta["reward_weights"]
        lock = Lockstep(request.task, min(LOCKSTEP, len(seeds)), image_size=request.image.size, reward_weights=weights)
        task = student.tasks.index(request.task.name)
        chance = rounds.beta**request.round

        def goals(batch: list[int]) -> Goals:
            return Lockstep.goal_vectors if student.goal == "vector" else training_goals(inputs["rollouts"], batch)

        return lambda batch: run_wave(
            expert, student, lock, batch, task, goals(batch), chance, labels=rounds.labels == "expert"
        )

    episodes: list[StoredEpisode] = []
    with ctx.progress(len(seeds), label) as bar:
        for at in range(0, len(seeds), LOCKSTEP):
            batch = seeds[at : at + LOCKSTEP]
            episodes += wave(ctx.state, batch, lambda wanted: run_batch()(wanted))
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
    """The episodes of `seeds`, in their order.

    task: the task's id, as the student counts. chance: that the expert acts, in each step. labels: whether to store the
    expert's mean in every visited state, as `mean_action`.
    """
    means = Padded(Mean(expert), LOCKSTEP)

    def beside(step: Step) -> dict[str, np.ndarray]:
        recorded = {"by_expert": step.memory.by_first}
        if labels:
            recorded["mean_action"] = means.act({"state": step.observations["state"]}, None)[0]
        return recorded

    recorder = Episodes(beside)
    roll(lock, Mixture(means, student, chance), seeds, task=task, goals=goals, recorders=[recorder])
    return recorder.episodes()


def _summary(request: OnPolicyRequest, episodes: list[StoredEpisode]) -> dict:
    """`expert_queries` counts states in which the expert's action was labelled or executed, each once."""
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
