"""PPO on the privileged state, with stable-baselines3: one task, one core, checkpoints and a curve.

The run is cut into segments of one rollout. After each, everything that the next depends on is a
safetensors file and a JSON file, so that a killed run goes on. Environments restart their episodes
then, with seeds that depend on the step alone: uninterrupted runs restart them at the same places.
"""

from pathlib import Path

import numpy as np
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize

from acgd.experts import zoo
from acgd.experts.curve import Curve
from acgd.experts.policy import KNOWN_STATES, STATE_CLIP, Expert
from acgd.experts.ppo.settings import PPOSettings
from acgd.experts.settings import ExpertRequest
from acgd.experts.training_env import StateOnly
from acgd.store import checkpoint
from acgd.store.metrics import Metrics


def train_ppo(
    request: ExpertRequest, state: Path, metrics, progress, device: torch.device = torch.device("cpu")
) -> tuple[Path, list[dict]]:
    """Train, or go on from the checkpoint in `state`. Returns the folder of the best expert, and the learning curve.

    The networks of PPO, which take a tenth of its time, stay on the processor. `device` is where a policy is first
    fitted to the muscle controller, with warm_start muscle.

    The best is chosen by (final success, return) on validation seeds, never on the card's.
    """
    ppo: PPOSettings = request.expert
    envs = [StateOnly(request, i) for i in range(ppo.envs)]
    venv = VecNormalize(DummyVecEnv([lambda e=e: e for e in envs]), gamma=ppo.gamma, clip_obs=STATE_CLIP)
    rate = _LearningRate(ppo)
    model = PPO(
        "MlpPolicy", venv, seed=ppo.seed, device="cpu", verbose=0, learning_rate=rate,
        n_steps=ppo.rollout_steps, batch_size=ppo.batch, n_epochs=ppo.epochs, gamma=ppo.gamma,
        gae_lambda=ppo.gae_lambda, clip_range=ppo.clip, ent_coef=ppo.entropy,
        policy_kwargs={"net_arch": [ppo.width, ppo.width], "log_std_init": float(np.log(ppo.initial_std))},
    )  # fmt: skip
    points = _load(state, model, venv)
    if ppo.warm_start and not model.num_timesteps:
        _start_from(_first_expert(request, state, progress, device), ppo.warm_start, model, venv)
    curve = Curve(request, state, metrics, points)
    metrics.rewind(model.num_timesteps)
    meta = {"task": request.task.name, "gamma": ppo.gamma, "reward_weights": ppo.reward_weights, "algorithm": ppo.kind}
    segment = ppo.envs * ppo.rollout_steps
    due = ppo.checkpoint_every
    with progress(ppo.steps, f"expert {request.task.name}", done=model.num_timesteps) as bar:
        while model.num_timesteps < ppo.steps:
            before = model.num_timesteps
            for i, env in enumerate(envs):
                env.reseed([ppo.seed, before, i])
            torch.manual_seed(ppo.seed * 1_000_003 + before)
            np.random.seed((ppo.seed * 1_000_003 + before) % 2**32)
            model._last_obs = None  # restart the episodes, as a resumed run has to
            rate.step = before
            _freeze_policy(model, bool(ppo.warm_start) and before < VALUE_FIRST)
            model.learn(segment, reset_num_timesteps=False)
            now = model.num_timesteps
            if now // ppo.evaluate_every > before // ppo.evaluate_every or now >= ppo.steps:
                std = float(model.policy.log_std.detach().exp().mean())
                row = curve.add(export(model, venv, meta), now, std=std)
                bar.update(now - before, final=row["final"], ret=row["return"])
            else:
                bar.update(now - before)
            due -= now - before
            if due <= 0 or now >= ppo.steps:
                due = ppo.checkpoint_every
                metrics.flush()
                _save(state, model, venv, curve.points)
    return state / "best", curve.points


class _LearningRate:
    """Linear from start to end over the whole run. stable-baselines3 passes the fraction of a segment: not used."""

    def __init__(self, ppo: PPOSettings) -> None:
        self._ppo = ppo
        self.step = 0

    def __call__(self, _: float) -> float:
        left = max(0.0, 1.0 - self.step / self._ppo.steps)
        return self._ppo.learning_rate_end + (self._ppo.learning_rate - self._ppo.learning_rate_end) * left


VALUE_FIRST = 50_000
"""Steps after a warm start in which the policy is frozen and only the value function learns: the advantages of an
untrained value function would undo the policy."""


def _freeze_policy(model: PPO, frozen: bool) -> None:
    """Freezes or unfreezes the policy. The normaliser and the value function learn in both cases."""
    policy = model.policy
    for part in (policy.mlp_extractor.policy_net, policy.action_net):
        part.requires_grad_(not frozen)
    policy.log_std.requires_grad_(not frozen)


def _first_expert(request: ExpertRequest, state: Path, progress, device: torch.device) -> Expert:
    """The expert that the policy starts from: that of a task in the zoo, or one that is fitted here to the muscle
    controller."""
    if request.expert.first_task:
        return Expert.load(zoo.folder(request.expert.first_task))
    from acgd.experts.muscle.learn import train_muscle

    imitation = request.model_copy(update={"expert": request.expert.imitation()})
    with Metrics(state / "muscle" / "metrics.jsonl") as metrics:
        return Expert.load(train_muscle(imitation, state / "muscle", metrics, progress, device)[0])


def _start_from(expert: Expert, name: str, model: PPO, venv: VecNormalize) -> None:
    """Copies the policy and the state normaliser of `expert` into `model`. Its value function starts from nothing."""
    policy, hidden = model.policy, model.policy.mlp_extractor.policy_net
    ours = (policy.observation_space.shape[0], hidden[0].out_features, policy.action_space.shape[0])
    theirs = (expert.hidden1.in_features, expert.hidden1.out_features, expert.action.out_features)
    if expert.squashed or ours != theirs:
        raise ValueError(
            f"expert.warm_start: expert {name} has (state, width, action) {theirs}{' and is SAC' * expert.squashed}, "
            f"this one {ours}: choose an expert of PPO or muscle for the same kind of task, and set "
            "expert.width to its width"
        )
    pairs = ((hidden[0], expert.hidden1), (hidden[2], expert.hidden2), (policy.action_net, expert.action))
    for layer, first in pairs:
        layer.load_state_dict(first.state_dict())
    if (
        expert.meta.get("algorithm") != "muscle"
    ):  # its spread is that of its training's noise, not one that PPO has learned
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
    """One checkpoint: weights, Adam's moments and normalisers; step, updates and curve."""
    tensors = {f"policy.{name}": value for name, value in model.policy.state_dict().items()}
    tensors |= checkpoint.moments_of(model.policy.optimizer, "adam.")
    for name, rms in (("obs", venv.obs_rms), ("ret", venv.ret_rms)):
        tensors[f"{name}.mean"] = torch.as_tensor(np.atleast_1d(rms.mean), dtype=torch.float64)
        tensors[f"{name}.var"] = torch.as_tensor(np.atleast_1d(rms.var), dtype=torch.float64)
        tensors[f"{name}.count"] = torch.tensor([rms.count], dtype=torch.float64)
    notes = {"step": model.num_timesteps, "updates": model._n_updates, "curve": curve}
    checkpoint.save(state, tensors, notes)


def _load(state: Path, model: PPO, venv: VecNormalize) -> list[dict]:
    """Goes to the checkpoint if there is one; returns the curve so far."""
    saved = checkpoint.load(state)
    if saved is None:
        return []
    tensors, notes = saved
    model.policy.load_state_dict(checkpoint.under(tensors, "policy."))
    checkpoint.restore_moments(model.policy.optimizer, tensors, "adam.")
    for name, rms in (("obs", venv.obs_rms), ("ret", venv.ret_rms)):
        mean, var = tensors[f"{name}.mean"].numpy(), tensors[f"{name}.var"].numpy()
        rms.mean, rms.var = (mean, var) if name == "obs" else (mean[0], var[0])
        rms.count = float(tensors[f"{name}.count"])
    model.num_timesteps, model._n_updates = notes["step"], notes["updates"]
    return notes["curve"]
