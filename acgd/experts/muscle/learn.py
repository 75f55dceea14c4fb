"""Imitation of the muscle controller by dataset aggregation (Ross et al. 2011): an expert without trial and error.

In every round the present policy acts, with noise (in the first, the controller). The controller gives its action in
each visited state, and the policy is fitted to all rounds so far. A round is one file, and its seeds depend on the
round alone: a killed run goes on with the round it was in, and ends with the same bytes.

It does not use simulate/roll.py: a round counts steps, not episodes, and episodes restart at once within it.
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
"""Weight of actions beside excitations in the loss: most of the action range is no excitation at all."""
EPSILON = 1e-4
"""Least standard deviation of a state's normaliser."""


def train_muscle(
    request: ExpertRequest, state: Path, metrics, progress, device: torch.device = torch.device("cpu")
) -> tuple[Path, list[dict]]:
    """Train, or go on from the checkpoint in `state`; the network runs on `device`. Returns the folder of the best
    expert, and the learning curve, whose steps are labelled states.

    The best is chosen by (final success, return) on validation seeds, never on the card's.
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
    expert = _first(envs[0], settings, meta).to(device)
    optimiser = torch.optim.Adam(expert.parameters(), lr=settings.learning_rate, eps=1e-5)
    saved = checkpoint.load(state)
    done, points = 0, []
    if saved is not None:
        checkpoint.restore(saved[0], expert, optimiser, {})
        done, points = saved[1]["rounds"], saved[1]["curve"]
    known = [load_file(_file(state, i)) for i in range(done)]
    curve = Curve(request, state, metrics, points)
    size = settings.steps // settings.rounds
    metrics.rewind(done * size)
    with progress(settings.steps, f"expert {request.task.name}", done=done * size) as bar:
        while done < settings.rounds:
            file = _file(state, done)
            if not file.is_file():
                new = _round(envs, teachers, None if done == 0 else expert, size, [settings.seed, done])
                replace_file(file, lambda draft, new=new: save_file(new, draft))
            known.append(load_file(file))
            states, actions = (torch.cat([part[name] for part in known]).to(device) for name in ("states", "actions"))
            if done == 0:
                expert.state_mean.copy_(states.mean(0))
                expert.state_std.copy_(states.std(0).clamp_min(EPSILON))
            loss = _fit(expert, optimiser, states, actions, settings, done)
            done += 1
            point = curve.add(expert, done * size, loss=loss)
            bar.update(size, final=point["final"], ret=point["return"])
            metrics.flush()
            _save(state, expert, optimiser, {"rounds": done, "curve": curve.points})
    return state / "best", curve.points


def _file(state: Path, number: int) -> Path:
    """Where the labelled states of a round lie."""
    return state / f"round-{number:03}.safetensors"


def _save(state: Path, expert: Expert, optimiser: torch.optim.Optimizer, notes: dict) -> None:
    checkpoint.save(state, checkpoint.training_state(expert, optimiser, {}), notes)


def _first(env: StateOnly, settings: MuscleSettings, meta: dict) -> Expert:
    """A policy whose layers start like torch's, with the spread of `exploration`."""
    with torch.random.fork_rng():
        torch.manual_seed(settings.seed)
        expert = Expert(env.observation_space.shape[0], env.action_space.shape[0], settings.width, meta)
    expert.log_std.fill_(float(np.log(settings.exploration)))
    return expert


def _round(
    envs: list[StateOnly], teachers: list[MuscleControl], expert: Expert | None, size: int, seed: list[int]
) -> dict[str, Tensor]:
    """`states` (N, S) that `expert` visits, or the teacher if None, and the teacher's `actions` (N, A) in them."""
    rng = np.random.default_rng(seed)
    for i, env in enumerate(envs):
        env.reseed([*seed, i])
    now = np.stack([env.reset()[0] for env in envs])
    states, actions = [], []
    for _ in range(size // len(envs)):
        labels = np.stack([teacher.action() for teacher in teachers])
        states.append(now.copy())
        actions.append(labels)
        noise = rng.standard_normal(labels.shape).astype(np.float32)
        taken = labels if expert is None else expert.act(now, noise)
        for i, env in enumerate(envs):
            after, _, terminated, truncated, _ = env.step(taken[i])
            now[i] = env.reset()[0] if terminated or truncated else after
    return {"states": torch.from_numpy(np.concatenate(states)), "actions": torch.from_numpy(np.concatenate(actions))}


def _fit(
    expert: Expert,
    optimiser: torch.optim.Optimizer,
    states: Tensor,
    actions: Tensor,
    settings: MuscleSettings,
    done: int,
) -> float:
    """`epochs` passes over all labelled states; the step size falls linearly over the rounds. Returns the mean loss of
    the last pass."""
    for group in optimiser.param_groups:
        group["lr"] = settings.learning_rate * (1 - done / settings.rounds)
    generator = torch.Generator().manual_seed(settings.seed * 1_000_003 + done)
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
