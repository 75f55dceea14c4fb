"""Q_agg = [Q_1, ..., Q_m] (paper III-B): the critics of all tasks as one frozen module that a student is guided by."""

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from acgd.nn.excitation import to_critic_input
from acgd.nn.q_ensemble import STATE_CLIP, Critic


class AggregateCritic(nn.Module):
    """(Q_agg(s, a) - Q_agg(s, a_0)) . t_i: what the critic of the row's own task gives an action over a reference, in
    its spreads.

    The reference, the demonstrated action, is a constant: the gradient by a is that of Q. But what the members make of
    the state cancels, and their disagreement is about the action alone; of a dueling critic only the advantage is
    needed.

    Rows are sorted by task and padded to the most frequent one; then a layer of all members of all tasks is one batched
    product, and no critic sees a row of another task. Weights are constants, so that gradient reaches the action alone.
    """

    def __init__(self, critics: list[Critic], pessimism: float) -> None:
        """`critics` in the order of the task ids. A gain is mean - pessimism * std over a critic's members."""
        super().__init__()
        shapes = [critic.shape for critic in critics]
        for name in ("action_dim", "members", "width", "depth", "action_space"):
            if len({shape[name] for shape in shapes}) != 1:
                raise ValueError(
                    f"critics differ in {name}: {[shape[name] for shape in shapes]}; fit them with one critic section"
                )
        self.pessimism, self.tasks, self.members = pessimism, len(critics), shapes[0]["members"]
        self.depth, self.state_dim = shapes[0]["depth"], max(shape["state_dim"] for shape in shapes)
        self.action_space = shapes[0]["action_space"]

        def constant(name: str, value: Tensor) -> None:
            self.register_buffer(name, value.detach().clone())

        def widened(value: Tensor, fill: float) -> Tensor:
            return F.pad(value, (0, self.state_dim - value.shape[-1]), value=fill)

        constant("state_mean", torch.stack([widened(critic.state_mean, 0.0) for critic in critics]))
        constant("state_std", torch.stack([widened(critic.state_std, 1.0) for critic in critics]))
        constant("scale", torch.stack([critic.action_scale / critic.spread for critic in critics]))
        stacks = [critic.action_networks for critic in critics]
        first = [
            stack["weights"][0].split((shape["state_dim"], shape["action_dim"]), 1)
            for stack, shape in zip(stacks, shapes)
        ]
        constant("weight_state", torch.cat([widened(w.mT, 0.0).mT for w, _ in first]))
        constant("weight_action", torch.cat([w for _, w in first]))
        for layer in range(self.depth + 1):
            constant(f"bias{layer}", torch.cat([stack["biases"][layer] for stack in stacks]))
            if layer:
                constant(f"weight{layer}", torch.cat([stack["weights"][layer] for stack in stacks]))
            if layer < self.depth:
                constant(f"gain{layer}", torch.cat([stack["gains"][layer] for stack in stacks]))
                constant(f"offset{layer}", torch.cat([stack["offsets"][layer] for stack in stacks]))
        self.eval()

    def forward(self, state: Tensor, action: Tensor, reference: Tensor, task: Tensor) -> Tensor:
        """(B, S zero-padded), (B, A) in [-1, 1] twice, (B,) long -> (B,), in spreads of each row's task; 0 where the
        actions are equal."""
        order, slot, longest = _grouping(task, self.tasks)
        state, action, reference = (
            _padded(rows[order], slot, self.tasks, longest) for rows in (state, action, reference)
        )
        with torch.no_grad():
            state = ((state - self.state_mean[:, None]) / self.state_std[:, None]).clamp(-STATE_CLIP, STATE_CLIP)
            of_state = torch.baddbmm(self.bias0, self._per_member(state), self.weight_state)
            before = self._q(of_state, reference)
        gain = self.scale[:, None, None] * (self._q(of_state, action) - before)
        doubt = (gain.var(1, correction=0) + 1e-12).sqrt() if self.pessimism else 0.0  # a root has no gradient at 0
        gain = gain.mean(1) - self.pessimism * doubt
        return gain.flatten()[slot][torch.argsort(order)]

    def _q(self, of_state: Tensor, action: Tensor) -> Tensor:
        """First layer's part of the state (m * M, n, width), actions (m, n, A) -> the networks' output (m, M, n)."""
        x = torch.baddbmm(of_state, self._per_member(to_critic_input(action, self.action_space)), self.weight_action)
        for layer in range(self.depth):
            if layer:
                x = torch.baddbmm(getattr(self, f"bias{layer}"), x, getattr(self, f"weight{layer}"))
            normal = F.layer_norm(x, x.shape[-1:])
            x = F.silu(torch.addcmul(getattr(self, f"offset{layer}"), normal, getattr(self, f"gain{layer}")))
        q = torch.baddbmm(getattr(self, f"bias{self.depth}"), x, getattr(self, f"weight{self.depth}"))
        return q.squeeze(-1).unflatten(0, (self.tasks, self.members))

    def _per_member(self, x: Tensor) -> Tensor:
        """(m, n, d) -> (m * M, n, d)"""
        return x[:, None].expand(-1, self.members, -1, -1).flatten(0, 1)


def _grouping(task: Tensor, tasks: int) -> tuple[Tensor, Tensor, int]:
    """(B,) task ids -> order that sorts rows by task, place of each sorted row in (tasks * longest), and `longest`."""
    counts = torch.bincount(task, minlength=tasks)
    if len(counts) > tasks:
        raise ValueError(
            f"task id {int(task.max())} for {tasks} critics: give the critics of all tasks of the study, in its order"
        )
    order = torch.argsort(task, stable=True)
    longest = int(counts.max())
    starts = torch.cumsum(counts, 0) - counts
    sorted_task = task[order]
    slot = sorted_task * longest + torch.arange(len(task), device=task.device) - starts[sorted_task]
    return order, slot, longest


def _padded(rows: Tensor, slot: Tensor, tasks: int, longest: int) -> Tensor:
    """(B, d) sorted rows -> (tasks, longest, d), zeros where a task has fewer."""
    return rows.new_zeros(tasks * longest, rows.shape[-1]).index_copy(0, slot, rows).unflatten(0, (tasks, longest))
