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
        for name in ("action_dim", "members", "width", "depth", "action_space", "dueling"):
            if len({shape[name] for shape in shapes}) != 1:
                raise ValueError(f"critics differ in {name}: {[shape[name] for shape in shapes]}; fit them with one critic section")
        self.pessimism, self.tasks, self.members = pessimism, len(critics), shapes[0]["members"]
        self.depth, self.state_dim = shapes[0]["depth"], max(shape["state_dim"] for shape in shapes)
        self.action_space, self.dueling = shapes[0]["action_space"], shapes[0]["dueling"]

        def constant(name: str, value: Tensor) -> None:
            self.register_buffer(name, value.detach().clone())

        def widened(values: list[Tensor], fill: float) -> list[Tensor]:
            return [F.pad(value, (0, self.state_dim - value.shape[-1]), value=fill) for value in values]

        constant("state_mean", torch.stack(widened([critic.state_mean for critic in critics], 0.0)))
        constant("state_std", torch.stack(widened([critic.state_std for critic in critics], 1.0)))
        constant("spread", torch.stack([critic.spread for critic in critics]))
        constant("shift", torch.stack([critic.shift for critic in critics]) / self.spread)
        constant("scale", torch.stack([critic.scale for critic in critics]) / self.spread)
        if self.dueling:
            constant("advantage_scale", torch.stack([critic.advantage_unit for critic in critics]) * self.scale)
        for part in range(1 + self.dueling):
            networks = slice(part * self.members, (part + 1) * self.members)
            first = [critic.weights[0][networks] for critic in critics]
            split = [w.split((w.shape[1] - shapes[0]["action_dim"], shapes[0]["action_dim"]), 1) for w in first]
            constant(f"weight_state{part}", torch.cat([w.mT for w in widened([w.mT for w, _ in split], 0.0)]))
            constant(f"weight_action{part}", torch.cat([w for _, w in split]))
            for layer in range(self.depth + 1):
                constant(f"bias{part}{layer}", torch.cat([critic.biases[layer][networks] for critic in critics]))
                if layer:
                    constant(f"weight{part}{layer}", torch.cat([critic.weights[layer][networks] for critic in critics]))
                if layer < self.depth:
                    constant(f"gain{part}{layer}", torch.cat([critic.gains[layer][networks] for critic in critics]))
                    constant(f"offset{part}{layer}", torch.cat([critic.offsets[layer][networks] for critic in critics]))
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
            state = ((state - self.state_mean[:, None]) / self.state_std[:, None]).clamp(-STATE_CLIP, STATE_CLIP)
        action = measured(action, self.action_space)
        if self.dueling:
            with torch.no_grad():  # V has no gradient by the action
                value = self._networks(0, state, action)
            q = self.scale[:, None, None] * value + self.advantage_scale[:, None, None] * self._networks(1, state, action)
        else:
            q = self.scale[:, None, None] * self._networks(0, state, action)
        q = self.shift[:, None, None] + q
        if not self.pessimism:
            return q.mean(1)
        return q.mean(1) - self.pessimism * (q.var(1, correction=0) + 1e-12).sqrt()  # std has no gradient at 0

    def _networks(self, part: int, state: Tensor, action: Tensor) -> Tensor:
        """Normalised (m, n, S), measured (m, n, A) -> (m, M, n): networks `part` of all members of all tasks."""
        with torch.no_grad():
            x = torch.baddbmm(getattr(self, f"bias{part}0"), self._per_member(state), getattr(self, f"weight_state{part}"))
        x = torch.baddbmm(x, self._per_member(action), getattr(self, f"weight_action{part}"))
        for layer in range(self.depth):
            if layer:
                x = torch.baddbmm(getattr(self, f"bias{part}{layer}"), x, getattr(self, f"weight{part}{layer}"))
            normal = F.layer_norm(x, x.shape[-1:])
            x = F.silu(torch.addcmul(getattr(self, f"offset{part}{layer}"), normal, getattr(self, f"gain{part}{layer}")))
        q = torch.baddbmm(getattr(self, f"bias{part}{self.depth}"), x, getattr(self, f"weight{part}{self.depth}"))
        return q.squeeze(-1).unflatten(0, (self.tasks, self.members))

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
