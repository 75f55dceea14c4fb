"""Demonstrations of several tasks on one time axis, on the device; windows of them as gathers.

Everything that a training step needs is an index into tensors that stay where they are: no workers, no
loop over items.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from acgd.rollouts.dataset import Demonstrations


@dataclass(frozen=True)
class Windows:
    """Steps of all tasks, concatenated in the order of the study: N = sum of T, K = sum of E."""

    steps: dict[str, Tensor]
    """Name -> (N, ...). Arrays narrower than the widest task's (`state`) are zero-padded on the right."""
    episodes: dict[str, Tensor]
    """Name -> (K, ...): what an episode has once."""
    task: Tensor
    """(N,) long: index in the study's list of tasks."""
    episode: Tensor
    """(N,) long: index into `episodes`."""
    start: Tensor
    """(N,) long: first step of the step's episode."""
    end: Tensor
    """(N,) long: one past its last step."""
    episode_task: Tensor
    """(K,) long."""
    training: Tensor
    """(n,) long: steps of the training episodes."""
    validation: Tensor
    """(m,) long: steps of the held-out episodes."""

    @classmethod
    def join(
        cls,
        demonstrations: Sequence[Demonstrations],
        steps: Sequence[Mapping[str, np.ndarray]],
        episodes: Sequence[Mapping[str, np.ndarray]],
        device: torch.device,
    ) -> "Windows":
        """One mapping of (T, ...) and one of (E, ...) arrays per task, from the store or from the features."""
        lengths = [demo.lengths for demo in demonstrations]
        all_lengths = np.concatenate(lengths)
        ends = np.cumsum(all_lengths)
        first_step = np.cumsum([0, *(part.sum() for part in lengths)])
        splits = [demo.split() for demo in demonstrations]

        def flat(which: int) -> Tensor:
            parts = [demo.steps_of(split[which]) + at for demo, split, at in zip(demonstrations, splits, first_step)]
            return torch.as_tensor(np.concatenate(parts), device=device)

        def per_step(values: np.ndarray) -> Tensor:
            return torch.as_tensor(np.repeat(values, all_lengths), device=device)

        episode_task = np.repeat(np.arange(len(lengths)), [len(part) for part in lengths])
        return cls(
            steps=_join(steps, device),
            episodes=_join(episodes, device),
            task=per_step(episode_task),
            episode=per_step(np.arange(len(all_lengths))),
            start=per_step(ends - all_lengths),
            end=per_step(ends),
            episode_task=torch.as_tensor(episode_task, device=device),
            training=flat(0),
            validation=flat(1),
        )

    def chunk(self, t: Tensor, k: int) -> tuple[Tensor, Tensor]:
        """Indices (B, k) of the steps t .. t+k-1, held at the episode's last step, and the mask (B, k) of its steps."""
        index = t[:, None] + torch.arange(k, device=t.device)
        end = self.end[t][:, None]
        return torch.minimum(index, end - 1), index < end

    def history(self, t: Tensor, h: int) -> Tensor:
        """Indices (B, h + 1) of the steps t-h .. t; before the episode's start its first step repeats."""
        index = t[:, None] + torch.arange(-h, 1, device=t.device)
        return torch.maximum(index, self.start[t][:, None])

    def earlier(self, t: Tensor, frames: int, stride: int) -> Tensor:
        """Indices (..., frames) of the steps t - (frames - 1) stride, .., t - stride, t, for t (...).

        Before the episode's start its first step repeats.
        """
        index = t[..., None] + stride * torch.arange(1 - frames, 1, device=t.device)
        return torch.maximum(index, self.start[t][..., None])

    def chunk_of(self, name: str, t: Tensor, k: int) -> tuple[Tensor, Tensor]:
        """`steps[name]` over the chunk, (B, k, ...), and its mask (B, k)."""
        index, mask = self.chunk(t, k)
        return self.steps[name][index], mask

    def history_of(self, name: str, t: Tensor, h: int) -> Tensor:
        """`steps[name]` over s_{t-h:t}, (B, h + 1, ...)."""
        return self.steps[name][self.history(t, h)]


def _join(parts: Sequence[Mapping[str, np.ndarray]], device: torch.device) -> dict[str, Tensor]:
    """Concatenate arrays by name; a last axis that differs is zero-padded to the widest."""
    joined = {}
    for name in parts[0]:
        values = [part[name] for part in parts]
        if values[0].ndim == 2:
            width = max(value.shape[1] for value in values)
            values = [np.pad(value, ((0, 0), (0, width - value.shape[1]))) for value in values]
        joined[name] = torch.as_tensor(np.concatenate(values), device=device)
    return joined
