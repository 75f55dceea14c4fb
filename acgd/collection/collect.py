"""Collect successful episodes of an expert, with everything needed to see, score or replay them again."""

import json
from collections.abc import Sequence

import numpy as np

from acgd.collection.episode import FIELDS, FINAL, ONCE, TERMS, StoredEpisode, run_wave, save_wave
from acgd.collection.settings import RolloutsRequest
from acgd.experts.policy import Expert
from acgd.rollouts.store import write_group
from acgd.simulate.lockstep import Lockstep
from acgd.simulate.seeds import SEEDS
from acgd.store.stage import Context, Inputs
from acgd.tasks import registry


class ExpertTooWeakError(RuntimeError):
    """The expert does not reach the wanted number of successes. The message names the mend."""


def collect(config: RolloutsRequest, inputs: Inputs, ctx: Context) -> None:
    """Run the expert until `demonstrations` episodes have succeeded, and keep those, in the order of their seeds.

    Writes rollouts.zarr (arrays: docs/rollouts.md) and summary.json. Episodes run in waves. A finished
    wave is on disk, so that a kill loses the running one alone; which seeds a wave holds follows from
    the waves before it, so that a resumed collection gives the same bytes.
    """
    expert = Expert.load(inputs["expert"])
    wanted = config.rollouts.demonstrations
    kept: list[StoredEpisode] = []
    failed: list[StoredEpisode] = []
    lock: Lockstep | None = None
    with ctx.progress(wanted, f"collecting {config.task.name}") as bar:
        while len(kept) < wanted:
            seeds = _next_seeds(config, len(kept), len(failed))
            file = ctx.state / f"wave-{seeds[0]}.safetensors"
            if not file.exists():
                lock = lock or _environments(config, expert)
                save_wave(file, run_wave(expert, lock, seeds, config.rollouts))
            before = len(kept)
            for i in range(len(seeds)):
                episode = StoredEpisode(file, i)
                (kept if episode["success_final"] else failed).append(episode)
            bar.update(len(kept) - before, failures=len(failed))
    store = ctx.out / "rollouts.zarr"
    layout = registry.make(config.task, image=False).state_layout
    attributes = {
        "task": config.task.name,
        "reward_terms": reward_terms(kept[0]),
        "state_layout": {name: [columns.start, columns.stop] for name, columns in layout.items()},
    }
    write_group(store, stack_episodes(kept), attributes)
    if config.rollouts.keep_failures and failed:
        write_group(store / "failures", stack_episodes(failed), {})
    (ctx.out / "summary.json").write_text(json.dumps(_summary(kept, failed), indent=1, sort_keys=True) + "\n")


def reward_terms(episode: StoredEpisode) -> list[str]:
    """Names of the reward's terms, in the order of the columns of `reward_terms`."""
    return sorted(name.removeprefix(TERMS) for name in episode.names() if name.startswith(TERMS))


def stack_episodes(episodes: Sequence[StoredEpisode]) -> dict[str, np.ndarray]:
    """The arrays of the store: per-step arrays end to end (T, ...), the others stacked (E, ...)."""
    names = [name for name in episodes[0].names() if not name.startswith(TERMS)]
    stacked = {}
    for name in names:
        once = name in ONCE or name.startswith((FINAL, FIELDS))
        stacked[name] = (np.stack if once else np.concatenate)([episode[name] for episode in episodes])
    terms = [np.concatenate([episode[TERMS + name] for episode in episodes]) for name in reward_terms(episodes[0])]
    stacked["reward_terms"] = np.stack(terms, axis=1)
    stacked["episode_ends"] = np.cumsum([len(episode["reward"]) for episode in episodes]).astype(np.int64)
    return stacked


def _next_seeds(config: RolloutsRequest, kept: int, failed: int) -> list[int]:
    """Seeds of the next wave: no more than are still missing, so that nothing is run in vain."""
    settings = config.rollouts
    attempted, limit = kept + failed, settings.attempts * settings.demonstrations
    if attempted >= limit:
        raise ExpertTooWeakError(
            f"the expert of {config.task.name} solved {kept} of {attempted} episodes, {settings.demonstrations} successes are wanted: "
            "take a better expert (expert.source: zoo, or more expert steps), ask for fewer rollouts.demonstrations, "
            "set rollouts.acting: mean, or raise rollouts.attempts"
        )
    n = min(settings.lockstep, settings.demonstrations - kept, limit - attempted)
    return SEEDS.demonstrations.take(n, offset=settings.seed_offset + attempted)


def _environments(config: RolloutsRequest, expert: Expert) -> Lockstep:
    n = min(config.rollouts.lockstep, config.rollouts.demonstrations)
    return Lockstep(config.task, n, image=True, reward_weights=expert.meta["reward_weights"])


def _summary(kept: list[StoredEpisode], failed: list[StoredEpisode]) -> dict:
    lengths = [len(episode["reward"]) for episode in kept]
    return {
        "demonstrations": len(kept),
        "failures": len(failed),
        "attempts": len(kept) + len(failed),
        "success": len(kept) / (len(kept) + len(failed)),
        "failed_seeds": [int(episode["seed"]) for episode in failed],
        "frames": sum(lengths),
        "environment_steps": sum(lengths) + sum(len(episode["reward"]) for episode in failed),
        "mean_return": float(np.mean([episode["reward"].sum() for episode in kept])),
        "held": float(np.mean([episode["success_held"] for episode in kept])),
    }
