"""The stage `rollouts`: demonstrations, which are successful episodes of an expert (docs/rollouts.md)."""

import json
from functools import cache

import numpy as np

from acgd.collection.settings import RolloutsConfig, RolloutsRequest
from acgd.collection.waves import StoredEpisode, steps, wave, write_rollouts
from acgd.experts.policy import Expert
from acgd.simulate.lockstep import Lockstep
from acgd.simulate.policy import Mean, Noisy, Policy, Sampled
from acgd.simulate.record import Episode, Episodes
from acgd.simulate.roll import roll
from acgd.simulate.seeds import SEEDS
from acgd.store.stage import Context, Inputs


class ExpertTooWeakError(RuntimeError):
    """The expert solves too few episodes. The message names the mend."""


def collect(request: RolloutsRequest, inputs: Inputs, ctx: Context) -> None:
    """Runs the expert until `demonstrations` episodes have succeeded. Keeps these in the order of their seeds.

    Writes rollouts.zarr (arrays: docs/rollouts.md) and summary.json. Episodes run in waves. Each finished wave is
    saved, so that a kill loses the running wave only. The results of earlier waves determine the seeds of a wave, so
    that a resumed collection gives the same bytes. Raises ExpertTooWeakError.
    """
    expert = Expert.load(inputs["expert"])
    wanted = request.rollouts.demonstrations
    kept: list[StoredEpisode] = []
    failed: list[StoredEpisode] = []

    @cache
    def lock() -> Lockstep:
        return _environments(request, expert)

    with ctx.progress(wanted, f"collecting {request.task.name}") as bar:
        while len(kept) < wanted:
            seeds = _next_seeds(request, len(kept), len(failed))
            before = len(kept)
            for episode in wave(ctx.state, seeds, lambda batch: run_wave(expert, lock(), batch, request.rollouts)):
                (kept if episode["success_final"] else failed).append(episode)
            bar.update(len(kept) - before, failures=len(failed))
    write_rollouts(ctx.out, request.task, kept, failed if request.rollouts.keep_failures else ())
    (ctx.out / "summary.json").write_text(json.dumps(_summary(kept, failed), indent=1, sort_keys=True) + "\n")


def run_wave(expert: Expert, lock: Lockstep, seeds: list[int], config: RolloutsConfig) -> list[Episode]:
    """Runs the episodes of `seeds`. Returns all of them in this order.

    All noise comes from one generator that is seeded with `seeds`, so the episodes depend on the arguments only.
    """
    rng = np.random.default_rng(seeds)
    policy: Policy = Mean(expert) if config.acting == "mean" else Sampled(expert, rng)
    if config.noise:
        policy = Noisy(policy, config.noise, rng)
    recorder = Episodes(lambda step: {"mean_action": expert.mean(step.observations["state"])})
    roll(lock, policy, seeds, recorders=[recorder])
    return recorder.episodes()


def _next_seeds(request: RolloutsRequest, kept: int, failed: int) -> list[int]:
    """Seeds of the next wave: at most as many as successes are missing. Raises ExpertTooWeakError."""
    settings = request.rollouts
    attempted, limit = kept + failed, settings.attempts * settings.demonstrations
    if attempted >= limit:
        raise ExpertTooWeakError(
            f"the expert of {request.task.name} solved {kept} of {attempted} episodes, and {settings.demonstrations} "
            "successes are needed. Take a better expert (expert.kind: zoo, or more expert steps), lower "
            "rollouts.demonstrations, set rollouts.acting: mean, or raise rollouts.attempts."
        )
    n = min(settings.lockstep, settings.demonstrations - kept, limit - attempted)
    return SEEDS.demonstrations.take(n, offset=settings.seed_offset + attempted)


def _environments(request: RolloutsRequest, expert: Expert) -> Lockstep:
    n = min(request.rollouts.lockstep, request.rollouts.demonstrations)
    weights = expert.meta["reward_weights"]
    return Lockstep(request.task, n, image_size=request.image.size, reward_weights=weights)


def _summary(kept: list[StoredEpisode], failed: list[StoredEpisode]) -> dict:
    return {
        "demonstrations": len(kept),
        "failures": len(failed),
        "attempts": len(kept) + len(failed),
        "success": len(kept) / (len(kept) + len(failed)),
        "failed_seeds": [int(episode["seed"]) for episode in failed],
        "frames": steps(kept),
        "environment_steps": steps(kept) + steps(failed),
        "mean_return": float(np.mean([episode["reward"].sum() for episode in kept])),
        "held": float(np.mean([episode["success_held"] for episode in kept])),
    }
