"""The critic stage: gather what the frozen expert meets, fit Q to it, and measure how far Q can be trusted."""

import json
import shutil
from pathlib import Path

import numpy as np
import torch

from acgd.critics import quality
from acgd.critics.fitted_q import FittedQ
from acgd.critics.gather import CANDIDATES, branches, candidates, rollouts
from acgd.critics.settings import CriticConfig, CriticRequest
from acgd.critics.transitions import Transitions, concatenate
from acgd.experts import zoo
from acgd.experts.policy import Expert
from acgd.experts.train import check, sha256
from acgd.nn.q_ensemble import WEIGHTS, Critic
from acgd.simulate.lockstep import Lockstep
from acgd.simulate.seeds import SEEDS
from acgd.store.progress import Progress
from acgd.store.stage import Context, Inputs
from acgd.tasks.spec import TASKS

ENVIRONMENTS = 8
"""Side by side in one process: enough to batch the expert, few enough to make."""
SPREAD_STATES, SPREAD_ACTIONS = 512, 16
"""That a task's unit of Q is measured on."""
VISITS_PER_BRANCH = 3
"""States kept to come back to, for each one that is drawn from them."""


def fit(config: CriticRequest, inputs: Inputs, ctx: Context) -> None:
    """{expert} -> critic.safetensors, critic.json, quality.json, within_state.csv."""
    if config.critic.source == "zoo":
        take(config.task.name, inputs["expert"], ctx)
        return
    expert = Expert.load(inputs["expert"])
    limit = TASKS[config.task.name].horizon
    lock = Lockstep(config.task, ENVIRONMENTS, image=False, reward_weights=expert.meta["reward_weights"])
    data = _gathered(lock, expert, limit, config.critic, ctx.state / "transitions.safetensors", ctx.progress)
    if config.critic.source == "expert":
        critic, branched = own(inputs["expert"]), 0
    else:
        fitted = FittedQ(data, config.critic, expert.meta["gamma"], ctx.device)
        _train(fitted, ctx)
        critic, branched = fitted.critic.eval(), len(fitted.groups)
    critic.spread.copy_(spread(critic, expert, data.state, np.random.default_rng([config.critic.seed, 2])))
    critic.meta = {
        "task": config.task.name,
        "source": config.critic.source,
        "gamma": expert.meta["gamma"],
        "reward_weights": expert.meta["reward_weights"],
        "simulator_steps": len(data),
        "transitions_terminated": int(data.terminated.sum()),
        "branched_states": branched,
        "expert_sha256": sha256(inputs["expert"] / "policy.safetensors"),
    }
    critic.save(ctx.out)
    found = quality.measure(critic, expert, lock, limit, config.critic, ctx.out / "within_state.csv", ctx.progress)
    (ctx.out / "quality.json").write_text(json.dumps(found, indent=1, sort_keys=True) + "\n")


def take(task: str, expert: Path, ctx: Context) -> None:
    """Copy the critic that lies in zoo/. Raises ValueError where it was fitted to another expert than the one in folder `expert`."""
    if check(zoo.folder(task))["sha256"] != sha256(expert / "policy.safetensors"):
        raise ValueError(
            f"critic.source is zoo, but the expert of {task} is not that of the zoo: set critic.source to fqe, or expert.source to zoo"
        )
    for file in zoo.fitted_critic(task):
        shutil.copyfile(file, ctx.out / file.name)


def own(folder: Path) -> Critic:
    """The critics that an off-policy expert has learned. Their Q holds the entropy bonus of its training.

    Raises ValueError where the expert has none.
    """
    if not (folder / WEIGHTS).is_file():
        raise ValueError(
            f"critic.source is expert, but {folder} has no {WEIGHTS}: only an off-policy expert (expert.algorithm sac) has critics "
            "of its own; set critic.source to fqe"
        )
    return Critic.load(folder)


def spread(critic: Critic, expert: Expert, states: np.ndarray, rng: np.random.Generator) -> float:
    """The standard deviation of Q over candidate actions of one state, the median of some of `states` (N, S), in reward units."""
    states = states[rng.choice(len(states), min(SPREAD_STATES, len(states)), replace=False)]
    actions, _ = candidates(expert, states, SPREAD_ACTIONS, rng)
    rows = torch.from_numpy(states).repeat_interleave(SPREAD_ACTIONS, 0), torch.from_numpy(actions).flatten(0, 1)
    with torch.no_grad():
        q = critic(*(value.to(critic.spread.device) for value in rows)).mean(0)
    return max(float(q.view(-1, SPREAD_ACTIONS).std(1).median()), 1e-6)


def gather(lock: Lockstep, expert: Expert, limit: int, config: CriticConfig, progress: Progress) -> Transitions:
    """Rollouts, then branches off states that they passed."""
    branch = config.branches if config.source == "fqe" else config.branches.model_copy(update={"states": 0})
    with progress(config.steps, "critic: rollouts, steps") as bar:
        data, visits, _ = rollouts(
            lock,
            expert,
            config.perturbation,
            SEEDS.critic_fit,
            limit=limit,
            steps=config.steps,
            visit_rate=min(1.0, VISITS_PER_BRANCH * branch.states / config.steps),
            seed=config.seed,
            bar=bar,
        )
    if not branch.states:
        return data
    if len(visits) < branch.states:
        raise ValueError(
            f"{len(visits)} visited states for {branch.states} branched ones: raise critic.steps or lower critic.branches.states"
        )
    rng = np.random.default_rng([config.seed, 0])
    chosen = [visits[i] for i in rng.choice(len(visits), branch.states, replace=False)]
    actions = _some_of(
        candidates(expert, np.stack([visit.state for visit in chosen]), max(branch.actions, 1 + len(CANDIDATES)), rng)[
            0
        ],
        branch.actions,
        rng,
    )
    with progress(actions.shape[0] * branch.actions * branch.steps, "critic: branches, steps at most") as bar:
        tried = branches(lock.envs, expert, chosen, actions, branch.steps, bar)
    return concatenate([data, tried])


def _some_of(actions: np.ndarray, count: int, rng: np.random.Generator) -> np.ndarray:
    """(V, K, A) -> (V, count, A): in each state the first, which is the expert's mean, and others by lot."""
    others = np.argsort(rng.random(actions.shape[:2])[:, 1:], 1)[:, : count - 1] + 1
    picked = np.concatenate([np.zeros((len(actions), 1), int), others], 1)
    return np.take_along_axis(actions, picked[:, :, None], 1)


def _gathered(
    lock: Lockstep, expert: Expert, limit: int, config: CriticConfig, kept: Path, progress: Progress
) -> Transitions:
    """What `gather` returns, simulated once even if the stage is killed later."""
    if not kept.exists():
        draft = kept.with_suffix(".tmp")
        gather(lock, expert, limit, config, progress).save(draft)
        draft.replace(kept)
    return Transitions.load(kept)


def _train(fitted: FittedQ, ctx: Context) -> None:
    """All updates, from the last checkpoint on."""
    checkpoint, config = ctx.state / "fitted_q.safetensors", fitted.config
    if checkpoint.exists():
        fitted.resume(checkpoint)
        ctx.metrics.rewind(fitted.step)
    with ctx.progress(config.updates, "critic: fitted Q evaluation", done=fitted.step) as bar:
        while fitted.step < config.updates:
            told = fitted.update()
            if told:
                ctx.metrics.log(fitted.step, **told)
            bar.update(1, **{name: told[name] for name in ("value_loss", "branch_loss") if name in told})
            if fitted.step % config.checkpoint_every == 0 or fitted.step == config.updates:
                ctx.metrics.flush()
                fitted.save(checkpoint)
