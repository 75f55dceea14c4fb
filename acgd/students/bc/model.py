"""Plain behaviour cloning: features, proprioception and task -> two hidden layers -> one action, with an L1 loss."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional as F

from acgd.nn.excitation import to_loss_space
from acgd.nn.losses import l1
from acgd.store.checkpoint import Generators
from acgd.store.stage import Inputs
from acgd.students.acting import observation
from acgd.students.bc.settings import BCConfig
from acgd.students.data import Batch, Data, Observation
from acgd.students.inputs import StudentInputs
from acgd.students.settings import ActingConfig, ImitationConfig
from acgd.students.student import Imitation, Sizes


class BC(nn.Module):
    """Observation -> a chunk of one action, strictly inside the box."""

    def __init__(self, settings: BCConfig, imitation: ImitationConfig, sizes: Sizes) -> None:
        super().__init__()
        self.settings, self.imitation, self.sizes = settings, imitation, sizes
        self.inputs = StudentInputs(imitation, sizes)
        read = self.inputs.width + sizes.proprio + sizes.tasks
        self.net = nn.Sequential(
            nn.Linear(read, settings.width),
            nn.ReLU(),
            nn.Linear(settings.width, settings.width),
            nn.ReLU(),
            nn.Linear(settings.width, sizes.actions),
        )

    def initialise(self, data: Data, inputs: Inputs) -> None:
        """Normalises its inputs by the demonstrations."""
        self.inputs.fit(data.windows)

    def prepare(self, data: Data, inputs: Inputs) -> dict[str, Tensor]:
        """The labels are the only targets."""
        return {}

    def forward(self, observation: Observation, noise: float = 0.0, generator: torch.Generator | None = None) -> Tensor:
        """-> (B, 1, A)."""
        vision, goal, proprio = self.inputs(observation, noise, generator)
        task = F.one_hot(observation.task, self.sizes.tasks).float()
        read = [vision, *([] if goal is None else [goal]), proprio[:, -1], task]
        return self.net(torch.cat(read, dim=-1)).float().tanh()[:, None]

    def imitate(self, batch: Batch, *, guided: int, noise: float, generators: Generators) -> Imitation:
        """The proposal is the imitating action itself."""
        action = self(batch.observation, noise, generators["data"])
        error = self.error(action, batch)
        return Imitation(error, action[:guided] if guided else None, {"l_act": error})

    def validate(self, batch: Batch) -> dict[str, Tensor]:
        """L_BC."""
        return {"validation_loss": self.error(self(batch.observation), batch)}

    def error(self, action: Tensor, batch: Batch) -> Tensor:
        """1-norm of the error of each window, (B, 1, A) -> (B,)."""
        space = self.imitation.action_space
        return l1(to_loss_space(action, space), to_loss_space(batch.chunk, space), batch.mask)

    @torch.no_grad()
    def plan(self, observation: Observation) -> Tensor:
        """(B, 1, A)."""
        return self(observation)

    def policy(self, acting: ActingConfig) -> "BCPolicy":
        """Acts step by step. `acting` is for chunks, and there are none."""
        return BCPolicy(self)


class Given(NamedTuple):
    """What does not change within an episode, a row per environment."""

    task: np.ndarray
    """(n,) int64."""
    goal: np.ndarray | None
    """(n, ...), as in an Observation."""


class BCPolicy:
    """One action a step, from the current observation alone."""

    def __init__(self, student: BC) -> None:
        self.student = student.eval()

    def start(self, tasks: np.ndarray, goals: np.ndarray | None, seeds: list[int]) -> Given:
        """tasks (n,), goals as in an Observation or None. It draws nothing, and so ignores the seeds."""
        return Given(np.asarray(tasks, np.int64), goals)

    @torch.inference_mode()
    def act(self, obs: Mapping[str, np.ndarray], memory: Given) -> tuple[np.ndarray, Given]:
        """obs: vision (n, ...) as in an Observation, proprio (n, P) -> actions (n, A) float32 in the box."""
        proprio = np.asarray(obs["proprio"], np.float32)[:, None]
        device = next(self.student.parameters()).device
        seen = observation(obs["vision"], memory.goal, proprio, memory.task, device)
        return self.student.plan(seen)[:, 0].cpu().numpy(), memory
