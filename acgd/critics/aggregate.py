"""Q_agg = [Q_1, ..., Q_m] (paper III-B): the critics of all tasks as one frozen module that a student is guided by."""

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from acgd.experts.q_ensemble import STATE_CLIP, Critic, measured


class AggregateCritic(nn.Module):
    """Q_agg(s, a) . t_i, the critic of the row's own task, in units of that task's spread of Q.

    Rows are sorted by task and padded to the most frequent one; then a layer of all members of all tasks is one
    batched product, and no critic sees a row of another task. Each critic's own normaliser is folded into its
    first layer's inputs; weights are constants, so that gradient reaches the action alone.
    """

    def __init__(self, critics: list[Critic], pessimism: float) -> None:
        """`critics` in the order of the task ids. Q is mean - pessimism * std over a critic's members."""
        super().__init__()
        shapes = [critic.shape for critic in critics]
        for name in ("action_dim", "members", "width", "depth", "action_space"):
            if len({shape[name] for shape in shapes}) != 1:
                raise ValueError(f"critics differ in {name}: {[shape[name] for shape in shapes]}; fit them with one critic section")
        self.pessimism, self.tasks, self.members = pessimism, len(critics), shapes[0]["members"]
        self.depth, self.state_dim = shapes[0]["depth"], max(shape["state_dim"] for shape in shapes)
        self.action_space = shapes[0]["action_space"]

        def padded(values: list[Tensor], fill: float) -> Tensor:
            return torch.stack([F.pad(value, (0, self.state_dim - value.shape[0]), value=fill) for value in values])

        def constant(name: str, value: Tensor) -> None:
            self.register_buffer(name, value.detach().clone())

        constant("state_mean", padded([critic.state_mean for critic in critics], 0.0))
        constant("state_std", padded([critic.state_std for critic in critics], 1.0))
        constant("spread", torch.stack([critic.spread for critic in critics]))
        constant("shift", torch.stack([critic.shift for critic in critics]) / self.spread)
        constant("scale", torch.stack([critic.scale for critic in critics]) / self.spread)
        first = [critic.weights[0] for critic in critics]
        constant("weight_state", torch.cat([F.pad(w[:, : c.shape["state_dim"]], (0, 0, 0, self.state_dim - c.shape["state_dim"])) for w, c in zip(first, critics)]))
        constant("weight_action", torch.cat([w[:, c.shape["state_dim"] :] for w, c in zip(first, critics)]))
        for layer in range(1, self.depth + 1):
            constant(f"weight{layer}", torch.cat([critic.weights[layer] for critic in critics]))
        for layer in range(self.depth):
            constant(f"gain{layer}", torch.cat([critic.gains[layer] for critic in critics]))
            constant(f"offset{layer}", torch.cat([critic.offsets[layer] for critic in critics]))
        for layer in range(self.depth + 1):
            constant(f"bias{layer}", torch.cat([critic.biases[layer] for critic in critics]))
        self.eval()

    def forward(self, state: Tensor, action: Tensor, task: Tensor) -> Tensor:
        """(B, S zero-padded), (B, A) in [-1, 1], (B,) long -> (B,), in spreads of each row's task."""
        order, slot, longest = _grouping(task, self.tasks)
        q = self._by_task(_padded(state[order], slot, self.tasks, longest), _padded(action[order], slot, self.tasks, longest))
        q = q.flatten()[slot]
        return q[torch.argsort(order)]

    def _by_task(self, state: Tensor, action: Tensor) -> Tensor:
        """(m, n, S), (m, n, A) -> (m, n), rows of one task each."""
        with torch.no_grad():
            state = (state - self.state_mean[:, None]) / self.state_std[:, None]
            state = state.clamp(-STATE_CLIP, STATE_CLIP)
            x = torch.baddbmm(self.bias0, self._per_member(state), self.weight_state)
        x = torch.baddbmm(x, self._per_member(measured(action, self.action_space)), self.weight_action)
        for layer in range(self.depth):
            if layer:
                x = torch.baddbmm(getattr(self, f"bias{layer}"), x, getattr(self, f"weight{layer}"))
            normal = F.layer_norm(x, x.shape[-1:])
            x = F.silu(torch.addcmul(getattr(self, f"offset{layer}"), normal, getattr(self, f"gain{layer}")))
        q = torch.baddbmm(getattr(self, f"bias{self.depth}"), x, getattr(self, f"weight{self.depth}"))
        q = q.squeeze(-1).unflatten(0, (self.tasks, self.members))
        q = self.shift[:, None, None] + self.scale[:, None, None] * q
        if not self.pessimism:
            return q.mean(1)
        return q.mean(1) - self.pessimism * (q.var(1, correction=0) + 1e-12).sqrt()  # std has no gradient at 0

    def _per_member(self, x: Tensor) -> Tensor:
        """(m, n, d) -> (m * M, n, d)"""
        return x[:, None].expand(-1, self.members, -1, -1).flatten(0, 1)


def _grouping(task: Tensor, tasks: int) -> tuple[Tensor, Tensor, int]:
    """(B,) task ids -> the order that sorts rows by task, each sorted row's place in (tasks * longest), and `longest`."""
    counts = torch.bincount(task, minlength=tasks)
    if len(counts) > tasks:
        raise ValueError(f"task id {int(task.max())} for {tasks} critics: give the critics of all tasks of the study, in its order")
    order = torch.argsort(task, stable=True)
    longest = int(counts.max())
    starts = torch.cumsum(counts, 0) - counts
    sorted_task = task[order]
    slot = sorted_task * longest + torch.arange(len(task), device=task.device) - starts[sorted_task]
    return order, slot, longest


def _padded(rows: Tensor, slot: Tensor, tasks: int, longest: int) -> Tensor:
    """(B, d) sorted rows -> (tasks, longest, d), zeros where a task has fewer."""
    return rows.new_zeros(tasks * longest, rows.shape[-1]).index_copy(0, slot, rows).unflatten(0, (tasks, longest))
