"""Q_i: an ensemble of LayerNorm networks on privileged state and action, stacked into batched weights.

SAC learns two of them beside its policy; fitted Q evaluation fits them to a frozen one. Both save the same files.
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
"""Normalised states are clipped here: a freak state must not throw a frozen critic off its data."""


class Critic(nn.Module):
    """Q(s, a) of one task's expert, for each member of the ensemble, in reward units.

    Parameters are stacked over the M members, `(M, in, out)`, so that a forward pass is one batched product per layer.
    Everything that maps raw inputs to reward units is inside, as buffers: `state_mean`, `state_std` (S,) normalise the
    state; `shift`, `scale` () turn the networks' output into a return; `spread` () is how far the Q of candidate
    actions of one state lie apart, the unit in which tasks are compared.

    A dueling critic (Wang et al. 2016) has two networks a member, Q = V(s) + `advantage_unit` A(s, a): the first M of
    the stack read states alone. What an action does is often a hundredth of what the state is worth; one network that
    learns both ranks actions by its errors in V. Unlike there, A is not centred: a continuous action has no mean over
    all actions, and the ranking needs none.
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
        # Without a bias before it, LayerNorm would make the first layer blind to the size of its input.
        self.biases = nn.ParameterList(
            nn.Parameter((torch.rand(networks, 1, m, generator=generator) * 2 - 1) / n**0.5)
            for n, m in zip(sizes, sizes[1:])
        )
        self.gains = nn.ParameterList(nn.Parameter(torch.ones(networks, 1, width)) for _ in range(depth))
        self.offsets = nn.ParameterList(nn.Parameter(torch.zeros(networks, 1, width)) for _ in range(depth))
        if dueling:
            self.register_buffer("advantage_unit", torch.ones(()))
            with torch.no_grad():
                self.weights[0][:members, state_dim:] = 0  # and so they stay: V is given zeros for the action
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
        """() from the output of those networks to reward units."""
        return self.scale * self.advantage_unit if self.shape["dueling"] else self.scale

    def normalise(self, state: Tensor) -> Tensor:
        """(..., S) in the simulator's units -> (..., S) as the networks read it."""
        return ((state - self.state_mean) / self.state_std).clamp(-STATE_CLIP, STATE_CLIP)

    def standard(self, state: Tensor, action: Tensor) -> Tensor:
        """(B, S), (B, A) -> (M, B), before `shift` and `scale`: what the fit regresses."""
        return self.network(self.normalise(state), action)

    def network(self, normal_state: Tensor, action: Tensor) -> Tensor:
        """`standard` for states that are normalised already."""
        action = to_critic_input(action, self.shape["action_space"])
        x = torch.cat([normal_state, action], -1).expand(self.members, -1, -1)
        if self.shape["dueling"]:
            blind = torch.cat([normal_state, torch.zeros_like(action)], -1).expand(self.members, -1, -1)
            x = torch.cat([blind, x])
        for weight, bias, gain, offset in zip(self.weights, self.biases, self.gains, self.offsets):
            normal = F.layer_norm(torch.baddbmm(bias, x, weight), weight.shape[-1:])
            x = F.silu(torch.addcmul(offset, normal, gain))
        # Returns need more digits than bf16 has. A product and a sum: for one column a batched matrix product takes
        # four times as long.
        weight, bias = self.weights[-1].float(), self.biases[-1].float()
        q = (x.float() * weight.transpose(1, 2)).sum(-1) + bias.squeeze(-1)
        return q[: self.members] + self.advantage_unit * q[self.members :] if self.shape["dueling"] else q

    def forward(self, state: Tensor, action: Tensor) -> Tensor:
        """(B, S), (B, A) in [-1, 1] -> (M, B), the expected discounted return of `action` followed by the expert."""
        return self.shift + self.scale * self.standard(state, action)

    def save(self, directory: Path) -> None:
        """Weights and normalisers as safetensors; shape and `meta` as JSON. The first weights of V are stored without
        the rows of the action."""
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
        """A critic as it was saved, in eval mode."""
        meta = json.loads((Path(directory) / META).read_text())
        critic = cls(**meta.pop("shape"))
        tensors = load_file(Path(directory) / WEIGHTS)
        if critic.shape["dueling"]:
            value, advantage = tensors.pop(f"{FIRST}.value"), tensors.pop(f"{FIRST}.advantage")
            tensors[FIRST] = torch.cat([F.pad(value, (0, 0, 0, critic.shape["action_dim"])), advantage])
        critic.load_state_dict(tensors)
        critic.meta = meta
        return critic.eval()
