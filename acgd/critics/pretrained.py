"""Critic sources `zoo` and `expert`: critics that exist already, in zoo/ or beside an off-policy expert's policy."""

import json
import shutil
from pathlib import Path

from acgd.critics import spread
from acgd.critics.gather import rollouts
from acgd.critics.settings import CriticRequest
from acgd.critics.simulated import lockstep, simulated_once
from acgd.experts import zoo
from acgd.experts.policy import Expert
from acgd.nn.q_ensemble import WEIGHTS, Critic
from acgd.simulate.seeds import SEEDS
from acgd.store.key import file_digest
from acgd.store.stage import Context
from acgd.tasks.spec import TASKS


def from_zoo(request: CriticRequest, expert: Path, ctx: Context) -> None:
    """Copies the critic in zoo/. ValueError where that critic was fitted to another expert than `expert`."""
    weights, meta = zoo.fitted_critic(request.task.name)
    if json.loads(meta.read_text())["expert_sha256"] != file_digest(expert / zoo.POLICY[0]):
        raise ValueError(
            f"critic.kind is zoo, but the expert of {request.task.name} is not that of the zoo: set "
            "critic.kind to fqe, or expert.kind to zoo"
        )
    for file in (weights, meta):
        shutil.copyfile(file, ctx.out / file.name)


def from_expert(request: CriticRequest, expert: Path, ctx: Context) -> None:
    """Copies the critics of an off-policy expert, and measures their spread.

    Their Q includes the entropy bonus of SAC. ValueError where the expert has no critics.
    """
    if not (expert / WEIGHTS).is_file():
        raise ValueError(
            f"critic.kind is expert, but {expert} has no {WEIGHTS}: only an off-policy expert (expert.kind sac) has "
            "critics; set critic.kind to fqe"
        )
    settings, policy = request.critic, Expert.load(expert)

    def gather():
        with ctx.progress(settings.steps, "critic: rollouts, steps") as bar:
            return rollouts(
                lockstep(request.task, policy), policy, settings.perturbation, SEEDS.critic_fit,
                limit=TASKS[request.task.name].horizon, steps=settings.steps, seed=settings.seed, bar=bar,
            )[0]  # fmt: skip

    data = simulated_once(ctx.state, gather)
    meta = {"task": request.task.name, "branched_states": 0}
    spread.save(Critic.load(expert), expert, data, ctx.out, settings, **meta)
