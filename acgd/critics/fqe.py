"""Critic source `fqe`: simulates the frozen expert, and fits Q to its transitions."""

from pathlib import Path

import numpy as np

from acgd.critics import spread
from acgd.critics.fitted_q import FittedQ
from acgd.critics.gather import CANDIDATES, branches, candidates, rollouts
from acgd.critics.settings import CriticRequest, FQESettings
from acgd.critics.simulated import lockstep, simulated_once
from acgd.critics.transitions import Transitions, concatenate
from acgd.experts.policy import Expert
from acgd.simulate.lockstep import Lockstep
from acgd.simulate.seeds import SEEDS
from acgd.store.progress import Progress
from acgd.store.stage import Context
from acgd.tasks.spec import TASKS

VISITS_PER_BRANCH = 3
"""Visited states that are kept for each state that branches start from."""


def fit(request: CriticRequest, expert: Path, ctx: Context) -> None:
    """Writes critic.safetensors and critic.json of the expert in the folder `expert`."""
    settings, policy = request.critic, Expert.load(expert)

    def simulate() -> Transitions:
        limit = TASKS[request.task.name].horizon
        return gather(lockstep(request.task, policy), policy, limit, settings, ctx.progress)

    data = simulated_once(ctx.state, simulate)
    fitted = FittedQ(data, settings, policy.meta["gamma"], ctx.device)
    _train(fitted, ctx)
    meta = {"task": request.task.name, "branched_states": len(fitted.groups)}
    spread.save(fitted.critic.eval(), expert, data, ctx.out, settings, **meta)


def gather(lock: Lockstep, expert: Expert, limit: int, settings: FQESettings, progress: Progress) -> Transitions:
    """Transitions of rollouts, and of branches that start from states of these rollouts.

    limit: control steps of an episode. ValueError where the rollouts visited too few states.
    """
    branch = settings.branches
    with progress(settings.steps, "critic: rollouts, steps") as bar:
        data, visits, _ = rollouts(
            lock,
            expert,
            settings.perturbation,
            SEEDS.critic_fit,
            limit=limit,
            steps=settings.steps,
            visit_rate=min(1.0, VISITS_PER_BRANCH * branch.states / settings.steps),
            seed=settings.seed,
            bar=bar,
        )
    if not branch.states:
        return data
    if len(visits) < branch.states:
        raise ValueError(
            f"{len(visits)} visited states for {branch.states} branched ones: raise critic.steps or lower "
            "critic.branches.states"
        )
    rng = np.random.default_rng([settings.seed, 0])
    chosen = [visits[i] for i in rng.choice(len(visits), branch.states, replace=False)]
    actions = _subset_of_actions(
        candidates(expert, np.stack([visit.state for visit in chosen]), max(branch.actions, 1 + len(CANDIDATES)), rng)[
            0
        ],
        branch.actions,
        rng,
    )
    with progress(actions.shape[0] * branch.actions * branch.steps, "critic: branches, steps at most") as bar:
        branch_data = branches(lock, expert, chosen, actions, branch.steps, bar)
    return concatenate([data, branch_data])


def _subset_of_actions(actions: np.ndarray, count: int, rng: np.random.Generator) -> np.ndarray:
    """(V, K, A) -> (V, count, A): the first action of each state, which is the expert's mean, and random others."""
    others = np.argsort(rng.random(actions.shape[:2])[:, 1:], 1)[:, : count - 1] + 1
    columns = np.concatenate([np.zeros((len(actions), 1), int), others], 1)
    return np.take_along_axis(actions, columns[:, :, None], 1)


def _train(fitted: FittedQ, ctx: Context) -> None:
    """Runs all remaining updates, with checkpoints."""
    settings = fitted.config
    fitted.resume(ctx.state)
    ctx.metrics.rewind(fitted.step)
    with ctx.progress(settings.updates, "critic: fitted Q evaluation", done=fitted.step) as bar:
        while fitted.step < settings.updates:
            losses = fitted.update()
            if losses:
                ctx.metrics.log(fitted.step, **losses)
            bar.update(1, **{name: losses[name] for name in ("value_loss", "branch_loss") if name in losses})
            if fitted.step % settings.checkpoint_every == 0 or fitted.step == settings.updates:
                ctx.metrics.flush()
                fitted.save(ctx.state)
