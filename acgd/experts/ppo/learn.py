"""PPO on the privileged state, with stable-baselines3: one task, one core, checkpoints and a learning curve.

The run consists of segments of one rollout. A checkpoint holds everything that the next segment depends on. Each
segment restarts all episodes with seeds that depend on the step alone, in resumed and in uninterrupted runs.
"""

from pathlib import Path

import numpy as np
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize

from acgd.experts import zoo
from acgd.experts.curve import Curve
from acgd.experts.policy import STATE_CLIP, WARM_START_STATES, Expert
from acgd.experts.ppo.settings import PPOSettings
from acgd.experts.settings import ExpertRequest
from acgd.experts.training_env import StateOnly
from acgd.store import checkpoint
from acgd.store.metrics import Metrics


def train_ppo(
    request: ExpertRequest, state: Path, metrics, progress, device: torch.device = torch.device("cpu")
) -> tuple[Path, list[dict]]:
    """Trains, or resumes from the checkpoint in `state`. Returns the folder of the best expert, and the learning curve.

    The networks of PPO take a tenth of the time and stay on the CPU. `device` is that of the imitation of the muscle
    controller, with warm_start: muscle. The best expert is chosen by (final success, return) on validation seeds.
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
        _start_from(_initial_expert(request, state, progress, device), ppo.warm_start, model, venv)
    curve = Curve(request, state, metrics, points)
    metrics.rewind(model.num_timesteps)
    meta = {"task": request.task.name, "gamma": ppo.gamma, "reward_weights": ppo.reward_weights, "algorithm": ppo.kind}
    segment = ppo.envs * ppo.rollout_steps
    steps_to_checkpoint = ppo.checkpoint_every
    with progress(ppo.steps, f"expert {request.task.name}", done=model.num_timesteps) as bar:
        while model.num_timesteps < ppo.steps:
            first_step = model.num_timesteps
            for i, env in enumerate(envs):
                env.reseed([ppo.seed, first_step, i])
            torch.manual_seed(ppo.seed * 1_000_003 + first_step)
            np.random.seed((ppo.seed * 1_000_003 + first_step) % 2**32)
            model._last_obs = None  # restarts the episodes, as a resumed run must
            rate.step = first_step
            _freeze_policy(model, bool(ppo.warm_start) and first_step < VALUE_ONLY_STEPS)
            model.learn(segment, reset_num_timesteps=False)
            last_step = model.num_timesteps
            if last_step // ppo.evaluate_every > first_step // ppo.evaluate_every or last_step >= ppo.steps:
                std = float(model.policy.log_std.detach().exp().mean())
                point = curve.add(export(model, venv, meta), last_step, std=std)
                bar.update(last_step - first_step, final=point["final"], ret=point["return"])
            else:
                bar.update(last_step - first_step)
            steps_to_checkpoint -= last_step - first_step
            if steps_to_checkpoint <= 0 or last_step >= ppo.steps:
                steps_to_checkpoint = ppo.checkpoint_every
                metrics.flush()
                _save(state, model, venv, curve.points)
    return state / "best", curve.points


class _LearningRate:
    """Linear schedule over the whole run. The argument of stable-baselines3 refers to a segment and is ignored."""

    def __init__(self, ppo: PPOSettings) -> None:
        self._ppo = ppo
        self.step = 0

    def __call__(self, _: float) -> float:
        remaining = max(0.0, 1.0 - self.step / self._ppo.steps)
        return self._ppo.learning_rate_end + (self._ppo.learning_rate - self._ppo.learning_rate_end) * remaining


VALUE_ONLY_STEPS = 50_000
"""Steps after a warm start in which the policy is frozen and only the value function learns. The advantages of an
untrained value function would destroy the policy."""


def _freeze_policy(model: PPO, frozen: bool) -> None:
    """Freezes or unfreezes the policy. The normaliser and the value function learn in both cases."""
    policy = model.policy
    for part in (policy.mlp_extractor.policy_net, policy.action_net):
        part.requires_grad_(not frozen)
    policy.log_std.requires_grad_(not frozen)


def _initial_expert(request: ExpertRequest, state: Path, progress, device: torch.device) -> Expert:
    """The expert of a warm start: an expert of the zoo, or a new imitation of the muscle controller."""
    if request.expert.warm_start_task:
        return Expert.load(zoo.folder(request.expert.warm_start_task))
    from acgd.experts.muscle.learn import train_muscle

    imitation = request.model_copy(update={"expert": request.expert.imitation()})
    with Metrics(state / "muscle" / "metrics.jsonl") as metrics:
        return Expert.load(train_muscle(imitation, state / "muscle", metrics, progress, device)[0])


def _start_from(expert: Expert, name: str, model: PPO, venv: VecNormalize) -> None:
    """Copies the policy and the state normaliser of `expert` into `model`, and leaves the value function untrained.

    ValueError where the sizes differ or the expert is a SAC policy.
    """
    policy, hidden = model.policy, model.policy.mlp_extractor.policy_net
    sizes = (policy.observation_space.shape[0], hidden[0].out_features, policy.action_space.shape[0])
    expert_sizes = (expert.hidden1.in_features, expert.hidden1.out_features, expert.action.out_features)
    if expert.squashed or sizes != expert_sizes:
        raise ValueError(
            f"expert.warm_start: expert {name} has (state, width, action) {expert_sizes}"
            f"{' and is SAC' * expert.squashed}, this one {sizes}: choose an expert of PPO or muscle for the same kind "
            "of task, and set expert.width to its width"
        )
    pairs = ((hidden[0], expert.hidden1), (hidden[2], expert.hidden2), (policy.action_net, expert.action))
    for layer, source in pairs:
        layer.load_state_dict(source.state_dict())
    # The standard deviation of an imitation is that of its training noise. PPO has not learned it.
    if expert.meta.get("algorithm") != "muscle":
        policy.log_std.data.copy_(expert.log_std)
    venv.obs_rms.mean, venv.obs_rms.var = expert.state_mean.double().numpy(), expert.state_std.double().square().numpy()
    venv.obs_rms.count = WARM_START_STATES


def export(model: PPO, venv: VecNormalize, meta: dict) -> Expert:
    """The policy of `model` and the normaliser of `venv` as an Expert."""
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
    """Writes a checkpoint: weights, Adam's moments, normalisers, step, number of updates, and curve."""
    tensors = {f"policy.{name}": value for name, value in model.policy.state_dict().items()}
    tensors |= checkpoint.moments_of(model.policy.optimizer, "adam.")
    for name, rms in (("obs", venv.obs_rms), ("ret", venv.ret_rms)):
        tensors[f"{name}.mean"] = torch.as_tensor(np.atleast_1d(rms.mean), dtype=torch.float64)
        tensors[f"{name}.var"] = torch.as_tensor(np.atleast_1d(rms.var), dtype=torch.float64)
        tensors[f"{name}.count"] = torch.tensor([rms.count], dtype=torch.float64)
    notes = {"step": model.num_timesteps, "updates": model._n_updates, "curve": curve}
    checkpoint.save(state, tensors, notes)


def _load(state: Path, model: PPO, venv: VecNormalize) -> list[dict]:
    """Loads the checkpoint in `state`, if any. Returns the curve so far."""
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
