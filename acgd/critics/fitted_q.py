"""Fitted Q evaluation: an ensemble regresses targets that are computed from its own values, with a frozen expert."""

import math
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from acgd.critics.settings import FQESettings
from acgd.critics.targets import Targets, targets
from acgd.critics.transitions import ROLLOUT, Transitions
from acgd.nn.excitation import to_critic_input
from acgd.nn.q_ensemble import Critic
from acgd.store import checkpoint

ROWS_AT_ONCE = 8192
STD_FLOOR = 1e-3
"""An entry of the state with a standard deviation below this is treated as a constant."""
DISTANCE_OFFSET = 0.1
"""Share of the median distance between two actions that is added to each distance. Without it the closest pair would
have all the weight."""


class FittedQ:
    """The state of the fit: critic, optimiser, targets, generator and number of updates.

    The loss regresses y over all transitions, and differences of z between the actions of one branched state. Both are
    in standardised returns. Equations: docs/method.md, "Fitted Q evaluation".
    """

    def __init__(self, data: Transitions, config: FQESettings, gamma: float, device: torch.device) -> None:
        self.config, self.device, self.step = config, device, 0
        self.generator = torch.Generator().manual_seed(config.seed)
        self.targets = targets(data.reward, data.terminated, data.on_policy, data.ends, gamma, config.horizon)
        self.targets = Targets(
            *(getattr(self.targets, name).to(device) for name in ("reward_sum", "discount", "bootstrap"))
        )
        self.state, self.action, self.next_state, self.next_action = (
            torch.from_numpy(array).to(device) for array in (data.state, data.action, data.next_state, data.next_action)
        )
        self.bootstrap_rows, self.bootstrap_index = torch.unique(self.targets.bootstrap, return_inverse=True)
        self.groups = branched_rows(data.branch, config.branches.actions).to(device)
        """(G, K) long: rows of the K actions of each of G branched states."""
        self.distance = self._distances() if config.within_state_unit == "distance" and len(self.groups) else None
        dims = data.state.shape[1], data.action.shape[1]
        self.critic = Critic(
            *dims, config.members, config.width, config.depth, config.action_space, config.dueling, self.generator
        )
        self.critic.to(device)
        self._normalise(data, gamma)
        self.optimiser = torch.optim.AdamW(
            self.critic.parameters(), config.lr, weight_decay=config.weight_decay, fused=True
        )
        self.y = self.z = torch.empty(0)

    def _normalise(self, data: Transitions, gamma: float) -> None:
        """Sets the normalisers of the critic.

        States: mean and standard deviation over the data. Returns: those of the summed rewards, continued for ever at
        the level of the last reward.
        """
        critic = self.critic
        critic.state_mean.copy_(torch.from_numpy(data.state.mean(0)))
        std = torch.from_numpy(data.state.std(0))
        critic.state_std.copy_(torch.where(std > STD_FLOOR, std, torch.ones_like(std)))
        last_reward = torch.from_numpy(data.reward).to(self.device)[self.targets.bootstrap]
        returns = self.targets.reward_sum + self.targets.discount * last_reward / (1 - gamma)
        critic.shift.copy_(returns.mean())
        critic.scale.copy_(returns.std().clamp_min(1e-6))

    def update(self) -> dict[str, float]:
        """One gradient step.

        Returns losses in standardised returns and statistics of the targets, every `target_every` updates; else {}.
        """
        losses = {}
        if self.step % self.config.target_every == 0:
            losses = self.refresh()
        config, critic = self.config, self.critic
        for group in self.optimiser.param_groups:
            group["lr"] = config.lr * 0.5 * (1 + math.cos(math.pi * self.step / config.updates))
        rows = torch.randint(len(self.state), (config.batch,), generator=self.generator).to(self.device)
        if len(self.groups) and config.within_state:
            states = torch.randint(len(self.groups), (config.branch_batch,), generator=self.generator).to(self.device)
            rows = torch.cat([rows, self.groups[states].flatten()])
        q = critic.network(self._with_state_noise(critic.normalise(self.state[rows])), self.action[rows])
        value_loss = (q - self.y[:, rows]).square().mean(1).sum()
        loss = value_loss
        if len(self.groups) and config.within_state:
            branch_q = q[:, config.batch :].unflatten(1, (config.branch_batch, -1))
            error = (self._differences(branch_q) - self.difference[states]) / self.unit[states]
            branch_loss = error.square().mean((1, 2)).sum()
            loss = loss + config.within_state * branch_loss
            if losses:
                losses["branch_loss"] = float(branch_loss.detach()) / config.members
        self.optimiser.zero_grad(set_to_none=True)
        loss.backward()
        self.optimiser.step()
        self.step += 1
        if losses:
            losses["value_loss"] = float(value_loss.detach()) / config.members
        return losses

    def _with_state_noise(self, state: Tensor) -> Tensor:
        """Adds Gaussian noise to normalised states (batch + g * K, S): one draw per state, shared by its K actions."""
        if not self.config.state_noise:
            return state
        batch_rows, actions = self.config.batch, self.config.branches.actions
        noise = torch.randn(
            batch_rows + (len(state) - batch_rows) // actions, state.shape[1], generator=self.generator
        ).to(self.device)
        return state + self.config.state_noise * torch.cat(
            [noise[:batch_rows], noise[batch_rows:].repeat_interleave(actions, 0)]
        )

    @torch.no_grad()
    def refresh(self) -> dict[str, float]:
        """Sets Q_target to Q, recomputes y (M, N) and z (G, K) in standardised returns, and returns statistics."""
        value = self.next_value()
        returns = self.targets.reward_sum + self.targets.discount * value
        y = (returns - self.critic.shift) / self.critic.scale
        target_shift = float((y - self.y).square().mean().sqrt()) if self.y.numel() else float("nan")
        self.y, z = y, branch_targets(self.targets, value, self.groups) / self.critic.scale
        if self.step == 0 and self.config.dueling and len(z):
            self.critic.advantage_unit.copy_(z.std(1).median().clamp_min(1e-6))
        self._set_branch_targets(z)
        return {"target_shift": target_shift, "target_mean": float(returns.mean()), "target_std": float(returns.std())}

    @torch.no_grad()
    def next_value(self) -> Tensor:
        """Q(s', pi_E(s')) of the state that each row bootstraps from, (M, N) in reward units."""
        value = torch.cat(
            [
                self.critic(self.next_state[rows], self.next_action[rows])
                for rows in self.bootstrap_rows.split(ROWS_AT_ONCE)
            ],
            1,
        )
        return value[:, self.bootstrap_index]

    def _set_branch_targets(self, z: Tensor) -> None:
        """z (G, K), in standardised returns up to a constant. Sets the differences of z and their unit."""
        self.z = z
        if not len(z):
            return
        self.difference = self._differences(z)
        if self.distance is None:
            spread, distance = z.std(1), 1.0
        else:
            spread, distance = (self.difference / self.distance).square().mean(1).sqrt(), self.distance
        # Without the median, states in which the action hardly matters would teach their noise.
        self.unit = (spread + spread.median()).clamp_min(1e-6)[:, None] * distance

    def _distances(self) -> Tensor:
        """(G, P) distances between the two actions of each of P pairs, in the action space of the critic."""
        critic_inputs = to_critic_input(self.action[self.groups], self.config.action_space)
        distance = self._differences(critic_inputs.movedim(2, 0)).norm(dim=0)
        return distance + DISTANCE_OFFSET * distance.median()

    def _differences(self, values: Tensor) -> Tensor:
        """Values (..., K) of the actions of a branched state -> differences, by `within_state_unit`.

        spread: (..., K), each from their mean. distance: (..., P), between the two of each pair.
        """
        if self.config.within_state_unit == "spread":
            return values - values.mean(-1, keepdim=True)
        first, second = torch.triu_indices(values.shape[-1], values.shape[-1], 1)
        return values[..., first] - values[..., second]

    # -- checkpoint --------------------------------------------------------------------------------

    def save(self, state: Path) -> None:
        """Writes a checkpoint into the folder `state`: everything that the next updates depend on."""
        tensors = {f"critic.{name}": value for name, value in self.critic.state_dict().items()}
        tensors |= checkpoint.moments_of(self.optimiser, "optimiser.")
        tensors |= {"y": self.y, "z": self.z, "generator": self.generator.get_state()}
        checkpoint.save(state, tensors, {"step": self.step})

    def resume(self, state: Path) -> None:
        """Loads the checkpoint in `state`, if any. A resumed fit gives the same bytes as an uninterrupted one."""
        saved = checkpoint.load(state)
        if saved is None:
            return
        tensors, notes = saved
        self.critic.load_state_dict(checkpoint.under(tensors, "critic."))
        checkpoint.restore_moments(self.optimiser, tensors, "optimiser.")
        self.generator.set_state(tensors["generator"])
        self.y = tensors["y"].to(self.device)
        self._set_branch_targets(tensors["z"].to(self.device))
        self.step = notes["step"]


def branch_targets(targets: Targets, next_value: Tensor, groups: Tensor) -> Tensor:
    """z (G, K) in reward units: summed rewards of each branch, and one bootstrap for all branches of a state.

    next_value: (M, N). groups: (G, K) long, rows of the branches.
    """
    discount = targets.discount[groups]
    alive = (discount > 0).float()
    shared_bootstrap = (next_value.mean(0)[groups] * alive).sum(1, keepdim=True) / alive.sum(1, keepdim=True).clamp_min(
        1
    )
    return targets.reward_sum[groups] + discount * shared_bootstrap


def branched_rows(branch: np.ndarray, actions: int) -> Tensor:
    """branch (N,) as in Transitions -> (G, K) rows of K = `actions` each. ValueError where K does not divide them."""
    rows = np.flatnonzero(branch != ROLLOUT)
    if len(rows) % actions:
        raise ValueError(
            f"{len(rows)} branches do not make groups of {actions}: branch every state with the same number of actions"
        )
    return torch.from_numpy(rows.reshape(-1, actions))
