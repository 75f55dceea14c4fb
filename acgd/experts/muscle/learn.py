"""Imitation of the muscle controller by dataset aggregation (DAgger, Ross et al. 2011).

The controller acts in the first round, the current policy with noise in later rounds. The controller labels every
visited state, and the policy is fitted to all rounds so far. A round is one file, and its seeds depend on the round
alone. A resumed run repeats at most one round, and ends with the same bytes as an uninterrupted run.

This file does not use simulate/roll.py: a round counts steps, and its episodes restart at once.
"""

from pathlib import Path

import numpy as np
import torch
from safetensors.torch import load_file, save_file
from torch import Tensor

from acgd.experts.curve import Curve
from acgd.experts.muscle.control import MuscleControl
from acgd.experts.muscle.settings import MuscleSettings
from acgd.experts.policy import Expert
from acgd.experts.settings import ExpertRequest
from acgd.experts.training_env import StateOnly
from acgd.nn.excitation import stretched_excitation
from acgd.store import checkpoint
from acgd.store.atomic import replace_file

ACTION_WEIGHT = 0.1
"""Weight of the action error beside the excitation error. Most of the action range maps to almost no excitation."""
EPSILON = 1e-4
"""Smallest standard deviation of the state normaliser."""


def train_muscle(
    request: ExpertRequest, state: Path, metrics, progress, device: torch.device = torch.device("cpu")
) -> tuple[Path, list[dict]]:
    """Trains on `device`, or resumes from the checkpoint in `state`.

    Returns the folder of the best expert, and the learning curve, whose steps count labelled states. The best expert is
    chosen by (final success, return) on validation seeds.
    """
    settings: MuscleSettings = request.expert
    envs = [StateOnly(request, i) for i in range(settings.envs)]
    teachers = [MuscleControl(env.unwrapped, settings) for env in envs]
    meta = {
        "task": request.task.name,
        "gamma": settings.gamma,
        "reward_weights": settings.reward_weights,
        "algorithm": settings.kind,
    }
    expert = _initial_policy(envs[0], settings, meta).to(device)
    optimiser = torch.optim.Adam(expert.parameters(), lr=settings.learning_rate, eps=1e-5)
    saved = checkpoint.load(state)
    rounds_done, points = 0, []
    if saved is not None:
        checkpoint.restore(saved[0], expert, optimiser, {})
        rounds_done, points = saved[1]["rounds"], saved[1]["curve"]
    rounds = [load_file(_round_file(state, i)) for i in range(rounds_done)]
    curve = Curve(request, state, metrics, points)
    size = settings.steps // settings.rounds
    metrics.rewind(rounds_done * size)
    with progress(settings.steps, f"expert {request.task.name}", done=rounds_done * size) as bar:
        while rounds_done < settings.rounds:
            file = _round_file(state, rounds_done)
            if not file.is_file():
                collected = _collect_round(
                    envs, teachers, None if rounds_done == 0 else expert, size, [settings.seed, rounds_done]
                )
                replace_file(file, lambda draft, collected=collected: save_file(collected, draft))
            rounds.append(load_file(file))
            states, actions = (torch.cat([part[name] for part in rounds]).to(device) for name in ("states", "actions"))
            if rounds_done == 0:
                expert.state_mean.copy_(states.mean(0))
                expert.state_std.copy_(states.std(0).clamp_min(EPSILON))
            loss = _fit(expert, optimiser, states, actions, settings, rounds_done)
            rounds_done += 1
            point = curve.add(expert, rounds_done * size, loss=loss)
            bar.update(size, final=point["final"], ret=point["return"])
            metrics.flush()
            _save(state, expert, optimiser, {"rounds": rounds_done, "curve": curve.points})
    return state / "best", curve.points


def _round_file(state: Path, number: int) -> Path:
    """File of the labelled states of a round."""
    return state / f"round-{number:03}.safetensors"


def _save(state: Path, expert: Expert, optimiser: torch.optim.Optimizer, notes: dict) -> None:
    checkpoint.save(state, checkpoint.training_state(expert, optimiser, {}), notes)


def _initial_policy(env: StateOnly, settings: MuscleSettings, meta: dict) -> Expert:
    """An untrained policy with torch's default weights and the standard deviation `exploration`."""
    with torch.random.fork_rng():
        torch.manual_seed(settings.seed)
        expert = Expert(env.observation_space.shape[0], env.action_space.shape[0], settings.width, meta)
    expert.log_std.fill_(float(np.log(settings.exploration)))
    return expert


def _collect_round(
    envs: list[StateOnly], teachers: list[MuscleControl], expert: Expert | None, size: int, seed: list[int]
) -> dict[str, Tensor]:
    """`states` (N, S) visited by `expert`, or by the teacher where it is None, and the teacher's `actions` (N, A)."""
    rng = np.random.default_rng(seed)
    for i, env in enumerate(envs):
        env.reseed([*seed, i])
    observed = np.stack([env.reset()[0] for env in envs])
    states, actions = [], []
    for _ in range(size // len(envs)):
        labels = np.stack([teacher.action() for teacher in teachers])
        states.append(observed.copy())
        actions.append(labels)
        noise = rng.standard_normal(labels.shape).astype(np.float32)
        taken = labels if expert is None else expert.act(observed, noise)
        for i, env in enumerate(envs):
            next_state, _, terminated, truncated, _ = env.step(taken[i])
            observed[i] = env.reset()[0] if terminated or truncated else next_state
    return {"states": torch.from_numpy(np.concatenate(states)), "actions": torch.from_numpy(np.concatenate(actions))}


def _fit(
    expert: Expert,
    optimiser: torch.optim.Optimizer,
    states: Tensor,
    actions: Tensor,
    settings: MuscleSettings,
    rounds_done: int,
) -> float:
    """Fits the policy to all labelled states in `epochs` passes. Returns the mean loss of the last pass.

    The step size falls linearly over the rounds.
    """
    for group in optimiser.param_groups:
        group["lr"] = settings.learning_rate * (1 - rounds_done / settings.rounds)
    generator = torch.Generator().manual_seed(settings.seed * 1_000_003 + rounds_done)
    normal = expert.normalised(states)
    excitations = stretched_excitation(actions)
    expert.requires_grad_(True)
    for _ in range(settings.epochs):
        losses = []
        for rows in torch.randperm(len(states), generator=generator).to(states.device).split(settings.batch):
            mean, _ = expert.network(normal[rows])
            loss = (stretched_excitation(mean) - excitations[rows]).square().mean() + ACTION_WEIGHT * (
                mean - actions[rows]
            ).square().mean()
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()
            losses.append(loss.detach())
    expert.requires_grad_(False)
    return float(torch.stack(losses).mean())
