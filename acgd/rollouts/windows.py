"""Demonstrations of several tasks on one time axis, on the device. A window is a gather by indices.

A training step needs no data workers and no loop over items.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from acgd.rollouts.dataset import Demonstrations


@dataclass(frozen=True)
class Windows:
    """Steps of all tasks, concatenated in the order of the study. N steps and K episodes in total."""

    steps: dict[str, Tensor]
    """Name -> (N, ...). Arrays whose width differs between tasks (`state`) are zero-padded on the right."""
    episodes: dict[str, Tensor]
    """Name -> (K, ...), values per episode."""
    task: Tensor
    """(N,) long: task id, the index in the study's list of tasks."""
    episode: Tensor
    """(N,) long: index into `episodes`."""
    start: Tensor
    """(N,) long: first step of the step's episode."""
    end: Tensor
    """(N,) long: exclusive end of the step's episode."""
    episode_task: Tensor
    """(K,) long: task id of each episode."""
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
        """Joins tasks. steps, episodes: one mapping per task, name -> (T, ...) and name -> (E, ...)."""
        lengths = [demo.lengths for demo in demonstrations]
        all_lengths = np.concatenate(lengths)
        ends = np.cumsum(all_lengths)
        first_step = np.cumsum([0, *(part.sum() for part in lengths)])
        splits = [demo.split() for demo in demonstrations]

        def steps_of_split(part: int) -> Tensor:
            parts = [
                demo.steps_of(split[part]) + offset for demo, split, offset in zip(demonstrations, splits, first_step)
            ]
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
            training=steps_of_split(0),
            validation=steps_of_split(1),
        )

    def chunk(self, t: Tensor, k: int) -> tuple[Tensor, Tensor]:
        """Indices (B, k) of steps t .. t+k-1, clamped to the episode's last step, and mask (B, k) of valid steps."""
        index = t[:, None] + torch.arange(k, device=t.device)
        end = self.end[t][:, None]
        return torch.minimum(index, end - 1), index < end

    def history(self, t: Tensor, h: int) -> Tensor:
        """Indices (B, h + 1) of steps t-h .. t, clamped to the episode's first step."""
        index = t[:, None] + torch.arange(-h, 1, device=t.device)
        return torch.maximum(index, self.start[t][:, None])

    def earlier(self, t: Tensor, frames: int, stride: int) -> Tensor:
        """Indices (..., frames) of the steps t - (frames - 1) stride, .., t - stride, t, for t (...).

        Before the episode's start its first step repeats.
        """
        index = t[..., None] + stride * torch.arange(1 - frames, 1, device=t.device)
        return torch.maximum(index, self.start[t][..., None])

    def chunk_of(self, name: str, t: Tensor, k: int) -> tuple[Tensor, Tensor]:
        """`steps[name]` over steps t .. t+k-1, (B, k, ...), and the mask (B, k)."""
        index, mask = self.chunk(t, k)
        return self.steps[name][index], mask

    def history_of(self, name: str, t: Tensor, h: int) -> Tensor:
        """`steps[name]` over steps t-h .. t, (B, h + 1, ...)."""
        return self.steps[name][self.history(t, h)]


def _join(parts: Sequence[Mapping[str, np.ndarray]], device: torch.device) -> dict[str, Tensor]:
    """Concatenates arrays by name. A last axis that differs is zero-padded to the largest width."""
    joined = {}
    for name in parts[0]:
        values = [part[name] for part in parts]
        if values[0].ndim == 2:
            width = max(value.shape[1] for value in values)
            values = [np.pad(value, ((0, 0), (0, width - value.shape[1]))) for value in values]
        joined[name] = torch.as_tensor(np.concatenate(values), device=device)
    return joined
