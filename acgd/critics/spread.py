"""Spread of a critic: standard deviation of Q over candidate actions of one state. It is the unit of guidance."""

from pathlib import Path
from typing import Literal

import numpy as np
import torch

from acgd.critics.gather import candidates
from acgd.critics.settings import ExpertCriticSettings, FQESettings
from acgd.critics.transitions import Transitions
from acgd.experts import zoo
from acgd.experts.policy import Expert
from acgd.nn.q_ensemble import Critic
from acgd.store.key import file_digest

STATES, ACTIONS = 512, 16
"""Largest number of states that the spread is the median of, and candidate actions in each."""
STREAM = 2
"""Second entropy of the generator of the spread; the first is the section's seed."""


def spread(
    critic: Critic, expert: Expert, states: np.ndarray, rng: np.random.Generator, over: Literal["all", "near"] = "all"
) -> float:
    """Median over states of the standard deviation of Q over candidate actions, in reward units.

    states: (N, S), of which at most STATES are drawn. over: "all" candidates, or those "near" the expert's action,
    which leaves out the uniform ones.
    """
    states = states[rng.choice(len(states), min(STATES, len(states)), replace=False)]
    actions, sources = candidates(expert, states, ACTIONS, rng)
    rows = torch.from_numpy(states).repeat_interleave(ACTIONS, 0), torch.from_numpy(actions).flatten(0, 1)
    with torch.no_grad():
        q = critic(*(value.to(critic.spread.device) for value in rows)).mean(0)
    columns = [k for k, source in enumerate(sources) if over == "all" or source != "uniform"]
    return max(float(q.view(-1, ACTIONS)[:, columns].std(1).median()), 1e-6)


def save(
    critic: Critic,
    expert: Path,
    data: Transitions,
    out: Path,
    settings: FQESettings | ExpertCriticSettings,
    **meta: object,
) -> None:
    """Measures the spread of `critic` on the states of `data`, and writes critic.safetensors and critic.json.

    expert: folder of the expert. out: folder that the files are written to. meta: further entries of critic.json.
    """
    policy = Expert.load(expert)
    rng = np.random.default_rng([settings.seed, STREAM])
    critic.spread.copy_(spread(critic, policy, data.state, rng, settings.spread))
    critic.meta = {
        "source": settings.kind,
        "gamma": policy.meta["gamma"],
        "reward_weights": policy.meta["reward_weights"],
        "simulator_steps": len(data),
        "transitions_terminated": int(data.terminated.sum()),
        "expert_sha256": file_digest(expert / zoo.POLICY[0]),
        **meta,
    }
    critic.save(out)
