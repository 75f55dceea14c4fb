"""The stage `rollouts`: successful episodes of an expert, with everything needed to see, score or replay them again."""

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
    """The expert does not reach the wanted number of successes. The message names the mend."""


def collect(request: RolloutsRequest, inputs: Inputs, ctx: Context) -> None:
    """Run the expert until `demonstrations` episodes have succeeded, and keep those, in the order of their seeds.

    Writes rollouts.zarr (arrays: docs/rollouts.md) and summary.json. Episodes run in waves. A finished
    wave is on disk, so that a kill loses the running one alone; which seeds a wave holds follows from
    the waves before it, so that a resumed collection gives the same bytes.
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
    """The episodes of `seeds`, in their order, successful or not.

    Depends on nothing but its arguments: all noise comes from one generator seeded with `seeds`.
    """
    rng = np.random.default_rng(seeds)
    policy: Policy = Mean(expert) if config.acting == "mean" else Sampled(expert, rng)
    if config.noise:
        policy = Noisy(policy, config.noise, rng)
    recorder = Episodes(lambda step: {"mean_action": expert.mean(step.observations["state"])})
    roll(lock, policy, seeds, recorders=[recorder])
    return recorder.episodes()


def _next_seeds(request: RolloutsRequest, kept: int, failed: int) -> list[int]:
    """Seeds of the next wave: no more than are still missing, so that nothing is run in vain."""
    settings = request.rollouts
    attempted, limit = kept + failed, settings.attempts * settings.demonstrations
    if attempted >= limit:
        raise ExpertTooWeakError(
            f"the expert of {request.task.name} solved {kept} of {attempted} episodes, {settings.demonstrations} "
            "successes are wanted: take a better expert (expert.kind: zoo, or more expert steps), ask for fewer "
            "rollouts.demonstrations, set rollouts.acting: mean, or raise rollouts.attempts"
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
