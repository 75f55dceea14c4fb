"""Plain behaviour cloning: features, proprioception and task -> two hidden layers -> one action, with an L1 loss."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional as F

from acgd.store.checkpoint import Generators
from acgd.store.stage import Inputs
from acgd.students.acting import to_observation
from acgd.students.bc.settings import BCConfig
from acgd.students.data import Batch, Data, Observation
from acgd.students.errors import l1_error
from acgd.students.inputs import StudentInputs
from acgd.students.settings import ActingConfig, ImitationConfig
from acgd.students.student import Imitation, Sizes


class BC(nn.Module):
    """An MLP: observation -> a chunk of one action in (-1, 1)^A."""

    def __init__(self, settings: BCConfig, imitation: ImitationConfig, sizes: Sizes) -> None:
        super().__init__()
        self.settings, self.imitation, self.sizes = settings, imitation, sizes
        self.inputs = StudentInputs(imitation, sizes)
        input_size = self.inputs.width + sizes.proprio + sizes.tasks
        self.net = nn.Sequential(
            nn.Linear(input_size, settings.width),
            nn.ReLU(),
            nn.Linear(settings.width, settings.width),
            nn.ReLU(),
            nn.Linear(settings.width, sizes.actions),
        )

    def initialise(self, data: Data, inputs: Inputs) -> None:
        """Fits the normalisers of the inputs to the demonstrations."""
        self.inputs.fit(data.windows)

    def prepare(self, data: Data, inputs: Inputs) -> dict[str, Tensor]:
        """Returns no further targets: the labels are the only ones."""
        return {}

    def forward(self, observation: Observation, noise: float = 0.0, generator: torch.Generator | None = None) -> Tensor:
        """Action (B, 1, A). noise: standard deviation on the normalised inputs."""
        vision, goal, proprio = self.inputs(observation, noise, generator)
        task = F.one_hot(observation.task, self.sizes.tasks).float()
        inputs = [vision, *([] if goal is None else [goal]), proprio[:, -1], task]
        return self.net(torch.cat(inputs, dim=-1)).float().tanh()[:, None]

    def imitate(self, batch: Batch, *, guided: int, noise: float, generators: Generators) -> Imitation:
        """L_BC is the L1 error of the action. The proposal is the same action."""
        action = self(batch.observation, noise, generators["data"])
        error = self.error(action, batch)
        return Imitation(error, action[:guided] if guided else None, {"l_act": error})

    def validate(self, batch: Batch) -> dict[str, Tensor]:
        """L_BC (B,)."""
        return {"validation_loss": self.error(self(batch.observation), batch)}

    def error(self, action: Tensor, batch: Batch) -> Tensor:
        """1-norm of the error of each window: action (B, 1, A) -> (B,)."""
        return l1_error(action, batch, self.imitation.action_space)

    @torch.no_grad()
    def plan(self, observation: Observation) -> Tensor:
        """The action (B, 1, A)."""
        return self(observation)

    def policy(self, acting: ActingConfig) -> "BCPolicy":
        """A policy that acts step by step. It ignores `acting`, which is for chunks."""
        return BCPolicy(self)


class Memory(NamedTuple):
    """Task and goal of each environment. They are constant within an episode."""

    task: np.ndarray
    """(n,) int64."""
    goal: np.ndarray | None
    """(n, ...) in the form of Observation. None: no goal."""


class BCPolicy:
    """Policy of BC: one action per step, from the current observation only."""

    def __init__(self, student: BC) -> None:
        self.student = student.eval()

    def start(self, tasks: np.ndarray, goals: np.ndarray | None, seeds: list[int]) -> Memory:
        """tasks (n,), goals in the form of Observation or None. The policy ignores `seeds`: it is deterministic."""
        return Memory(np.asarray(tasks, np.int64), goals)

    @torch.inference_mode()
    def act(self, obs: Mapping[str, np.ndarray], memory: Memory) -> tuple[np.ndarray, Memory]:
        """obs: vision as in Observation, proprio (n, P) -> actions (n, A) float32 in the box."""
        proprio = np.asarray(obs["proprio"], np.float32)[:, None]
        device = next(self.student.parameters()).device
        observation = to_observation(obs["vision"], memory.goal, proprio, memory.task, device)
        return self.student.plan(observation)[:, 0].cpu().numpy(), memory
