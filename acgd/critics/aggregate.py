"""Q_agg = [Q_1, ..., Q_m] (paper III-B): the critics of all tasks as one frozen module that guides a student."""

import torch
from torch import Tensor, nn
from torch.nn import functional as F

from acgd.nn.excitation import to_critic_input
from acgd.nn.q_ensemble import STATE_CLIP, Critic


class AggregateCritic(nn.Module):
    """Gain (Q_i(s, a) - Q_i(s, a_0)) / spread_i of an action over a reference action, by the critic of each row's task.

    Rows are grouped by task, so that a layer of all critics is one batched product. Only the action receives a
    gradient. Derivation: docs/method.md, "Aggregate critic".
    """

    def __init__(self, critics: list[Critic], pessimism: float) -> None:
        """critics: in the order of the task ids. The gain is mean - pessimism * std over the members of a critic.

        Raises ValueError where the critics differ in action space or in the size of their networks.
        """
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

        def add_constant(name: str, value: Tensor) -> None:
            self.register_buffer(name, value.detach().clone())

        def pad_state(value: Tensor, fill: float) -> Tensor:
            return F.pad(value, (0, self.state_dim - value.shape[-1]), value=fill)

        add_constant("state_mean", torch.stack([pad_state(critic.state_mean, 0.0) for critic in critics]))
        add_constant("state_std", torch.stack([pad_state(critic.state_std, 1.0) for critic in critics]))
        add_constant("scale", torch.stack([critic.action_scale / critic.spread for critic in critics]))
        stacks = [critic.action_networks for critic in critics]
        first_weights = [
            stack["weights"][0].split((shape["state_dim"], shape["action_dim"]), 1)
            for stack, shape in zip(stacks, shapes)
        ]
        add_constant("weight_state", torch.cat([pad_state(w.mT, 0.0).mT for w, _ in first_weights]))
        add_constant("weight_action", torch.cat([w for _, w in first_weights]))
        for layer in range(self.depth + 1):
            add_constant(f"bias{layer}", torch.cat([stack["biases"][layer] for stack in stacks]))
            if layer:
                add_constant(f"weight{layer}", torch.cat([stack["weights"][layer] for stack in stacks]))
            if layer < self.depth:
                add_constant(f"gain{layer}", torch.cat([stack["gains"][layer] for stack in stacks]))
                add_constant(f"offset{layer}", torch.cat([stack["offsets"][layer] for stack in stacks]))
        self.eval()

    def forward(self, state: Tensor, action: Tensor, reference: Tensor, task: Tensor) -> Tensor:
        """state (B, S) zero-padded, action and reference (B, A) in [-1, 1], task (B,) long -> gain (B,).

        The unit is the spread of the row's task. The gain is 0 where both actions are equal.
        """
        by_task, slot, rows_per_task = _places(task, self.tasks)
        state, action, reference = (
            _pad_tasks(rows[by_task], slot, self.tasks, rows_per_task) for rows in (state, action, reference)
        )
        with torch.no_grad():
            state = ((state - self.state_mean[:, None]) / self.state_std[:, None]).clamp(-STATE_CLIP, STATE_CLIP)
            state_term = torch.baddbmm(self.bias0, self._repeat_members(state), self.weight_state)
            reference_q = self._q(state_term, reference)
        gain = self.scale[:, None, None] * (self._q(state_term, action) - reference_q)
        disagreement = (
            (gain.var(1, correction=0) + 1e-12).sqrt() if self.pessimism else 0.0
        )  # a root has no gradient at 0
        gain = gain.mean(1) - self.pessimism * disagreement
        return gain.flatten()[slot][torch.argsort(by_task)]

    def _q(self, state_term: Tensor, action: Tensor) -> Tensor:
        """First layer's state term (T * M, n, width), actions (T, n, A) of T tasks -> network outputs (T, M, n)."""
        x = torch.baddbmm(
            state_term, self._repeat_members(to_critic_input(action, self.action_space)), self.weight_action
        )
        for layer in range(self.depth):
            if layer:
                x = torch.baddbmm(getattr(self, f"bias{layer}"), x, getattr(self, f"weight{layer}"))
            normalised = F.layer_norm(x, x.shape[-1:])
            x = F.silu(torch.addcmul(getattr(self, f"offset{layer}"), normalised, getattr(self, f"gain{layer}")))
        q = torch.baddbmm(getattr(self, f"bias{self.depth}"), x, getattr(self, f"weight{self.depth}"))
        return q.squeeze(-1).unflatten(0, (self.tasks, self.members))

    def _repeat_members(self, x: Tensor) -> Tensor:
        """(T, n, d) -> (T * M, n, d): each row for each of the M members."""
        return x[:, None].expand(-1, self.members, -1, -1).flatten(0, 1)


def _places(task: Tensor, tasks: int) -> tuple[Tensor, Tensor, int]:
    """Places of rows in a batch that has `rows_per_task` rows for each task.

    task (B,) long -> order (B,) that sorts the rows by task; place (B,) of each sorted row in tasks * rows_per_task;
    and rows_per_task, the number of rows of the most frequent task. ValueError for a task id without a critic.
    """
    counts = torch.bincount(task, minlength=tasks)
    if len(counts) > tasks:
        raise ValueError(
            f"task id {int(task.max())} for {tasks} critics: pass the critics of all tasks of the study, in its order"
        )
    by_task = torch.argsort(task, stable=True)
    rows_per_task = int(counts.max())
    starts = torch.cumsum(counts, 0) - counts
    sorted_task = task[by_task]
    slot = sorted_task * rows_per_task + torch.arange(len(task), device=task.device) - starts[sorted_task]
    return by_task, slot, rows_per_task


def _pad_tasks(rows: Tensor, slot: Tensor, tasks: int, rows_per_task: int) -> Tensor:
    """Sorted rows (B, d) -> (tasks, rows_per_task, d), padded with zeros."""
    return (
        rows.new_zeros(tasks * rows_per_task, rows.shape[-1])
        .index_copy(0, slot, rows)
        .unflatten(0, (tasks, rows_per_task))
    )
