"""Q_i: an ensemble of LayerNorm networks on privileged state and action, with stacked weights.

SAC and fitted Q evaluation train this critic and save the same files.
"""

import json
from pathlib import Path
from typing import Self

import torch
from safetensors.torch import load_file, save_file
from torch import Tensor, nn
from torch.nn import functional as F

from acgd.nn.excitation import ActionSpace, to_critic_input

WEIGHTS, META = "critic.safetensors", "critic.json"
FIRST = "weights.0"
STATE_CLIP = 10.0
"""Bound of normalised states: an extreme state must not leave the range that a frozen critic was trained on."""


class Critic(nn.Module):
    """Q(s, a) of one task's expert, for each of M members, in reward units.

    Parameters have shape (M, in, out). Buffers: state_mean, state_std (S,); shift, scale, spread, and of a dueling
    critic advantage_unit, (). Equations and reasons: docs/method.md, "Critic ensemble".
    """

    state_mean: Tensor
    state_std: Tensor
    shift: Tensor
    scale: Tensor
    spread: Tensor
    advantage_unit: Tensor

    def __init__(
        self,
        state_dim: int,
        action_dim: int,
        members: int = 2,
        width: int = 128,
        depth: int = 2,
        action_space: ActionSpace = "raw",
        dueling: bool = False,
        generator: torch.Generator | None = None,
    ) -> None:
        super().__init__()
        self.shape = {
            "state_dim": state_dim,
            "action_dim": action_dim,
            "members": members,
            "width": width,
            "depth": depth,
            "action_space": action_space,
            "dueling": dueling,
        }
        sizes, networks = [state_dim + action_dim] + [width] * depth + [1], (1 + dueling) * members
        self.weights = nn.ParameterList(
            nn.Parameter(torch.randn(networks, n, m, generator=generator) / n**0.5) for n, m in zip(sizes, sizes[1:])
        )
        # LayerNorm removes the scale of its input. A random bias before it keeps that scale visible.
        self.biases = nn.ParameterList(
            nn.Parameter((torch.rand(networks, 1, m, generator=generator) * 2 - 1) / n**0.5)
            for n, m in zip(sizes, sizes[1:])
        )
        self.gains = nn.ParameterList(nn.Parameter(torch.ones(networks, 1, width)) for _ in range(depth))
        self.offsets = nn.ParameterList(nn.Parameter(torch.zeros(networks, 1, width)) for _ in range(depth))
        if dueling:
            self.register_buffer("advantage_unit", torch.ones(()))
            with torch.no_grad():
                self.weights[0][:members, state_dim:] = (
                    0  # V receives zeros for the action, so that these weights stay 0
                )
        for name, value in {
            "state_mean": torch.zeros(state_dim),
            "state_std": torch.ones(state_dim),
            "shift": torch.zeros(()),
            "scale": torch.ones(()),
            "spread": torch.ones(()),
        }.items():
            self.register_buffer(name, value)
        self.meta: dict = {}

    @property
    def members(self) -> int:
        return self.shape["members"]

    @property
    def action_networks(self) -> dict[str, list[Tensor]]:
        """Weights, biases, gains and offsets of the networks that read the action, each (M, ...) by layer."""
        stacks = {"weights": self.weights, "biases": self.biases, "gains": self.gains, "offsets": self.offsets}
        return {name: [value[-self.members :] for value in stack] for name, stack in stacks.items()}

    @property
    def action_scale(self) -> Tensor:
        """() factor from the output of `action_networks` to reward units."""
        return self.scale * self.advantage_unit if self.shape["dueling"] else self.scale

    def normalise(self, state: Tensor) -> Tensor:
        """States (..., S) in the simulator's units -> normalised and clipped states (..., S)."""
        return ((state - self.state_mean) / self.state_std).clamp(-STATE_CLIP, STATE_CLIP)

    def standard(self, state: Tensor, action: Tensor) -> Tensor:
        """States (B, S), actions (B, A) -> standardised returns (M, B), which the fit regresses."""
        return self.network(self.normalise(state), action)

    def network(self, normal_state: Tensor, action: Tensor) -> Tensor:
        """As `standard`, for normalised states."""
        action = to_critic_input(action, self.shape["action_space"])
        x = torch.cat([normal_state, action], -1).expand(self.members, -1, -1)
        if self.shape["dueling"]:
            without_action = torch.cat([normal_state, torch.zeros_like(action)], -1).expand(self.members, -1, -1)
            x = torch.cat([without_action, x])
        for weight, bias, gain, offset in zip(self.weights, self.biases, self.gains, self.offsets):
            normalised = F.layer_norm(torch.baddbmm(bias, x, weight), weight.shape[-1:])
            x = F.silu(torch.addcmul(offset, normalised, gain))
        # Returns need more digits than bfloat16 has. For one output column a batched matrix product takes four times as
        # long as product and sum.
        weight, bias = self.weights[-1].float(), self.biases[-1].float()
        q = (x.float() * weight.transpose(1, 2)).sum(-1) + bias.squeeze(-1)
        return q[: self.members] + self.advantage_unit * q[self.members :] if self.shape["dueling"] else q

    def forward(self, state: Tensor, action: Tensor) -> Tensor:
        """States (B, S), actions (B, A) in [-1, 1] -> (M, B): discounted return of `action`, then of the expert."""
        return self.shift + self.scale * self.standard(state, action)

    def save(self, directory: Path) -> None:
        """Writes critic.safetensors (weights, normalisers) and critic.json (shape, `meta`).

        The first weights of V are stored without the rows of the action, which are 0.
        """
        tensors = {name: value.clone() for name, value in self.state_dict().items()}
        if self.shape["dueling"]:
            value, advantage = tensors.pop(FIRST).chunk(2)
            tensors |= {
                f"{FIRST}.value": value[:, : self.shape["state_dim"]].clone(),
                f"{FIRST}.advantage": advantage.clone(),
            }
        save_file(tensors, directory / WEIGHTS)
        (directory / META).write_text(json.dumps({"shape": self.shape, **self.meta}, indent=1, sort_keys=True) + "\n")

    @classmethod
    def load(cls, directory: Path) -> Self:
        """The saved critic, in eval mode."""
        meta = json.loads((Path(directory) / META).read_text())
        critic = cls(**meta.pop("shape"))
        tensors = load_file(Path(directory) / WEIGHTS)
        if critic.shape["dueling"]:
            value, advantage = tensors.pop(f"{FIRST}.value"), tensors.pop(f"{FIRST}.advantage")
            tensors[FIRST] = torch.cat([F.pad(value, (0, 0, 0, critic.shape["action_dim"])), advantage])
        critic.load_state_dict(tensors)
        critic.meta = meta
        return critic.eval()
