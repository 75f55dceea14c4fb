"""PPO on the privileged state, with stable-baselines3: one task, one core, checkpoints and a curve.

The run is cut into segments of one rollout. After each, everything that the next depends on is a
safetensors file and a JSON file, so that a killed run goes on. Environments restart their episodes
then, with seeds that depend on the step alone: uninterrupted runs restart them at the same places.
"""

import json
from pathlib import Path

import numpy as np
import torch
from safetensors.torch import load_file, save_file
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize

from acgd.experts import zoo
from acgd.experts.curve import Curve
from acgd.experts.policy import KNOWN_STATES, STATE_CLIP, Expert
from acgd.experts.settings import ExpertRequest, PPOConfig
from acgd.experts.training_env import StateOnly
from acgd.store import checkpoint
from acgd.store.atomic import replace_file
from acgd.store.metrics import Metrics


def train_ppo(
    config: ExpertRequest, state: Path, metrics, progress, device: torch.device = torch.device("cpu")
) -> tuple[Expert, list[dict]]:
    """Train, or go on from the checkpoint in `state`. Returns the best expert and the learning curve. PPO's own networks, which
    take a tenth of its time, stay on the processor; `device` is where a muscle controller's pupil is fitted first.

    The best is chosen by (final success, return) on validation seeds, never on the card's.
    """
    settings, ppo = config.expert, config.expert.ppo
    envs = [StateOnly(config, i) for i in range(ppo.envs)]
    venv = VecNormalize(DummyVecEnv([lambda e=e: e for e in envs]), gamma=ppo.gamma, clip_obs=STATE_CLIP)
    rate = _LearningRate(ppo)
    model = PPO(
        "MlpPolicy", venv, seed=settings.seed, device="cpu", verbose=0, learning_rate=rate,
        n_steps=ppo.rollout_steps, batch_size=ppo.batch, n_epochs=ppo.epochs, gamma=ppo.gamma,
        gae_lambda=ppo.gae_lambda, clip_range=ppo.clip, ent_coef=ppo.entropy,
        policy_kwargs={"net_arch": [ppo.width, ppo.width], "log_std_init": float(np.log(ppo.initial_std))},
    )  # fmt: skip
    points = _load(state, model, venv)
    if settings.warm_start and not model.num_timesteps:
        _start_from(_first_expert(config, state, progress, device), settings.warm_start, model, venv)
    curve = Curve(config, state, metrics, points)
    metrics.rewind(model.num_timesteps)
    meta = {"task": config.task.name, "gamma": ppo.gamma, "reward_weights": settings.reward_weights, "algorithm": "ppo"}
    segment = ppo.envs * ppo.rollout_steps
    due = settings.checkpoint_every
    with progress(ppo.steps, f"expert {config.task.name}", done=model.num_timesteps) as bar:
        while model.num_timesteps < ppo.steps:
            before = model.num_timesteps
            for i, env in enumerate(envs):
                env.reseed([settings.seed, before, i])
            torch.manual_seed(settings.seed * 1_000_003 + before)
            np.random.seed((settings.seed * 1_000_003 + before) % 2**32)
            model._last_obs = None  # restart the episodes, as a resumed run has to
            rate.step = before
            _hold_policy(model, bool(settings.warm_start) and before < VALUE_FIRST)
            model.learn(segment, reset_num_timesteps=False)
            now = model.num_timesteps
            if now // settings.evaluate_every > before // settings.evaluate_every or now >= ppo.steps:
                std = float(model.policy.log_std.detach().exp().mean())
                row = curve.add(export(model, venv, meta), now, std=std)
                bar.update(now - before, final=row["final"], ret=row["return"])
            else:
                bar.update(now - before)
            due -= now - before
            if due <= 0 or now >= ppo.steps:
                due = settings.checkpoint_every
                metrics.flush()
                _save(state, model, venv, curve.points)
    return Expert.load(state / "best"), curve.points


class _LearningRate:
    """Linear from start to end over the whole run. The fraction that stable-baselines3 passes is of one segment: not used."""

    def __init__(self, ppo: PPOConfig) -> None:
        self._ppo = ppo
        self.step = 0

    def __call__(self, _: float) -> float:
        left = max(0.0, 1.0 - self.step / self._ppo.steps)
        return self._ppo.learning_rate_end + (self._ppo.learning_rate - self._ppo.learning_rate_end) * left


VALUE_FIRST = 50_000
"""Steps in which a policy that has a warm start stands still, and only its value function learns: advantages of an untrained one undo it."""


def _hold_policy(model: PPO, still: bool) -> None:
    """Whether updates leave the policy alone; the normaliser and the value function learn on."""
    policy = model.policy
    for part in (policy.mlp_extractor.policy_net, policy.action_net):
        part.requires_grad_(not still)
    policy.log_std.requires_grad_(not still)


def _first_expert(config: ExpertRequest, state: Path, progress, device: torch.device) -> Expert:
    """What the policy starts from: the expert of a task in the zoo, or one that is trained here from the muscle controller."""
    if config.expert.first_task:
        return Expert.load(zoo.folder(config.expert.first_task))
    from acgd.experts.muscle.learn import train_dagger

    with Metrics(state / "dagger" / "metrics.jsonl") as own:
        return train_dagger(config, state / "dagger", own, progress, device)[0]


def _start_from(expert: Expert, name: str, model: PPO, venv: VecNormalize) -> None:
    """Give `model` the policy and the state normaliser of another expert. Its value function starts from nothing."""
    policy, hidden = model.policy, model.policy.mlp_extractor.policy_net
    ours = (policy.observation_space.shape[0], hidden[0].out_features, policy.action_space.shape[0])
    theirs = (expert.hidden1.in_features, expert.hidden1.out_features, expert.action.out_features)
    if expert.squashed or ours != theirs:
        raise ValueError(
            f"expert.warm_start: the expert {name} has (state, width, action) {theirs}{' and is SAC' * expert.squashed}, "
            f"this one {ours}: choose a PPO expert of the same kind of task, and its expert.ppo.width"
        )
    pairs = ((hidden[0], expert.hidden1), (hidden[2], expert.hidden2), (policy.action_net, expert.action))
    for layer, first in pairs:
        layer.load_state_dict(first.state_dict())
    if expert.meta.get("algorithm") != "dagger":  # which did not explore: `initial_std` stays
        policy.log_std.data.copy_(expert.log_std)
    venv.obs_rms.mean, venv.obs_rms.var = expert.state_mean.double().numpy(), expert.state_std.double().square().numpy()
    venv.obs_rms.count = KNOWN_STATES


def export(model: PPO, venv: VecNormalize, meta: dict) -> Expert:
    """The policy of `model` with the normaliser of `venv`, as plain torch."""
    policy = model.policy
    hidden = policy.mlp_extractor.policy_net
    state_dim, action_dim = policy.observation_space.shape[0], policy.action_space.shape[0]
    expert = Expert(state_dim, action_dim, hidden[0].out_features, meta)
    expert.load_state_dict(
        {
            "state_mean": torch.as_tensor(venv.obs_rms.mean, dtype=torch.float32),
            "state_std": torch.as_tensor(np.sqrt(venv.obs_rms.var + venv.epsilon), dtype=torch.float32),
            "log_std": policy.log_std.detach(),
            "hidden1.weight": hidden[0].weight.detach(), "hidden1.bias": hidden[0].bias.detach(),
            "hidden2.weight": hidden[2].weight.detach(), "hidden2.bias": hidden[2].bias.detach(),
            "action.weight": policy.action_net.weight.detach(), "action.bias": policy.action_net.bias.detach(),
        }
    )  # fmt: skip
    return expert


def _save(state: Path, model: PPO, venv: VecNormalize, curve: list[dict]) -> None:
    """One atomic checkpoint: weights, Adam's moments and normalisers; step and curve."""
    state.mkdir(parents=True, exist_ok=True)
    tensors = {f"policy.{k}": v.detach().clone().contiguous() for k, v in model.policy.state_dict().items()}
    tensors |= checkpoint.moments_of(model.policy.optimizer, "adam.")
    for name, rms in (("obs", venv.obs_rms), ("ret", venv.ret_rms)):
        tensors[f"{name}.mean"] = torch.as_tensor(np.atleast_1d(rms.mean), dtype=torch.float64)
        tensors[f"{name}.var"] = torch.as_tensor(np.atleast_1d(rms.var), dtype=torch.float64)
        tensors[f"{name}.count"] = torch.tensor([rms.count], dtype=torch.float64)
    note = {
        "step": json.dumps(model.num_timesteps),
        "updates": json.dumps(model._n_updates),
        "curve": json.dumps(curve),
    }
    replace_file(state / "checkpoint.safetensors", lambda draft: save_file(tensors, draft, metadata=note))


def _load(state: Path, model: PPO, venv: VecNormalize) -> list[dict]:
    """Go to the checkpoint if there is one; returns the curve so far."""
    path = state / "checkpoint.safetensors"
    if not path.is_file():
        return []
    from safetensors import safe_open

    with safe_open(path, "pt") as file:
        note = file.metadata()
    tensors = load_file(path)
    model.policy.load_state_dict(checkpoint.under(tensors, "policy."))
    checkpoint.restore_moments(model.policy.optimizer, tensors, "adam.")
    for name, rms in (("obs", venv.obs_rms), ("ret", venv.ret_rms)):
        mean, var = tensors[f"{name}.mean"].numpy(), tensors[f"{name}.var"].numpy()
        rms.mean, rms.var = (mean, var) if name == "obs" else (mean[0], var[0])
        rms.count = float(tensors[f"{name}.count"])
    model.num_timesteps, model._n_updates = json.loads(note["step"]), json.loads(note["updates"])
    return json.loads(note["curve"])
