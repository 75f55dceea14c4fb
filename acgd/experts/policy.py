"""A trained expert as a torch module: a Gaussian policy on the privileged state."""

import json
from pathlib import Path

import numpy as np
import torch
from safetensors.torch import load_file, save_file
from torch import Tensor, nn

STATE_CLIP = 10.0
"""Standard deviations at which normalised states are clipped, as in training."""
WARM_START_STATES = 100_000
"""Number of states that the statistics of a warm start count as."""
LOG_STD = (-5.0, 1.0)
"""Bounds of the log standard deviation of a squashed policy."""


class Expert(nn.Module):
    """Network of two hidden layers: state (S,) -> Gaussian over actions (A,) in [-1, 1].

    | | PPO, muscle | SAC (`squashed`) |
    |---|---|---|
    | activation | tanh | ReLU |
    | standard deviation | one for all states | depends on the state |
    | bound of actions | clip | tanh |

    The bounded action is what the simulator executes and what a student imitates.
    """

    def __init__(
        self, state_dim: int, action_dim: int, width: int, meta: dict | None = None, *, squashed: bool = False
    ) -> None:
        super().__init__()
        self.squashed = squashed
        self.register_buffer("state_mean", torch.zeros(state_dim))
        self.register_buffer("state_std", torch.ones(state_dim))
        self.hidden1 = nn.Linear(state_dim, width)
        self.hidden2 = nn.Linear(width, width)
        self.action = nn.Linear(width, action_dim)
        if squashed:
            self.spread = nn.Linear(width, action_dim)
        else:
            self.register_buffer("log_std", torch.zeros(action_dim))
        self.meta = dict(meta or {})
        """Task, reward weights and discount of the training."""
        self.eval().requires_grad_(False)

    def mean_tensor(self, state: Tensor) -> Tensor:
        """Deterministic action (B, A) in [-1, 1] for states (B, S)."""
        return self._into_box(self.gaussian(state)[0])

    def gaussian(self, state: Tensor) -> tuple[Tensor, Tensor]:
        """Mean and log standard deviation, each (B, A), before the bound of actions."""
        return self.network(self.normalised(state))

    def normalised(self, state: Tensor) -> Tensor:
        """States (B, S) normalised by the statistics of training and clipped at STATE_CLIP."""
        return ((state - self.state_mean) / self.state_std).clamp(-STATE_CLIP, STATE_CLIP)

    def network(self, normal_state: Tensor) -> tuple[Tensor, Tensor]:
        """As `gaussian`, for normalised states."""
        activation = torch.relu if self.squashed else torch.tanh
        x = activation(self.hidden2(activation(self.hidden1(normal_state))))
        mean = self.action(x)
        if not self.squashed:
            return mean, self.log_std.expand_as(mean)
        low, high = LOG_STD
        return mean, low + (high - low) * torch.sigmoid(self.spread(x))

    def _into_box(self, action: Tensor) -> Tensor:
        return torch.tanh(action) if self.squashed else action.clamp(-1.0, 1.0)

    def mean(self, state: np.ndarray) -> np.ndarray:
        """`mean_tensor` for arrays: (B, S) float32 -> (B, A) float32."""
        with torch.no_grad():
            return self.mean_tensor(self._tensor(state)).cpu().numpy()

    def sample(self, state: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """Sampled action (B, A) in [-1, 1] for states (B, S)."""
        noise = rng.standard_normal((len(state), self.action.out_features)).astype(np.float32)
        return self.act(state, noise)

    def act(self, state: np.ndarray, noise: np.ndarray) -> np.ndarray:
        """Action (B, A) in [-1, 1] for states (B, S) and standard normal noise (B, A)."""
        with torch.no_grad():
            mean, log_std = self.gaussian(self._tensor(state))
            return self._into_box(mean + log_std.exp() * self._tensor(noise)).cpu().numpy()

    def _tensor(self, array: np.ndarray) -> Tensor:
        """The array as float32 on the device of the weights."""
        return torch.from_numpy(np.ascontiguousarray(array, np.float32)).to(self.state_mean.device)

    def save(self, folder: Path) -> None:
        """Writes policy.safetensors and policy.json."""
        folder = Path(folder)
        save_file({k: v.contiguous() for k, v in self.state_dict().items()}, folder / "policy.safetensors")
        (folder / "policy.json").write_text(json.dumps(self.meta, indent=1, sort_keys=True) + "\n")

    @classmethod
    def load(cls, folder: Path) -> "Expert":
        """Reads policy.safetensors and policy.json. FileNotFoundError where one of them is missing."""
        folder = Path(folder)
        weights, meta = folder / "policy.safetensors", folder / "policy.json"
        for path in (weights, meta):
            if not path.is_file():
                raise FileNotFoundError(
                    f"no {path}: train an expert (expert.kind: ppo), or restore zoo/ from the repository"
                )
        tensors = load_file(weights)
        width, state_dim = tensors["hidden1.weight"].shape
        action_dim = tensors["action.weight"].shape[0]
        expert = cls(state_dim, action_dim, width, json.loads(meta.read_text()), squashed="spread.weight" in tensors)
        expert.load_state_dict(tensors)
        return expert

    @classmethod
    def random(cls, state_dim: int, action_dim: int, seed: int = 0, meta: dict | None = None) -> "Expert":
        """An untrained expert, for tests and benchmarks."""
        expert = cls(state_dim, action_dim, 32, {"reward_weights": {}, "gamma": 0.97} | dict(meta or {}))
        generator = torch.Generator().manual_seed(seed)
        for layer in (expert.hidden1, expert.hidden2, expert.action):
            layer.weight.copy_(torch.randn(layer.weight.shape, generator=generator) / layer.in_features**0.5)
            layer.bias.zero_()
        expert.log_std.fill_(-1.0)
        return expert
