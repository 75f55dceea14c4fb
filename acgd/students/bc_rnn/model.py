"""Recurrent behaviour cloning (robomimic's BC-RNN): an LSTM over observations -> an action at each step.

A window is `sequence` observations from step t on, each with its action. The memory is zero at t, so that the j-th
action of a window follows from j + 1 observations. A policy whose memory starts anew every `sequence` steps is in
that state too: the error of `plan`, which averages over the steps of a window, is the error of what it would do.
Guidance judges the action of every step in the state of that step.
"""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional as F

from acgd.nn.excitation import to_loss_space
from acgd.nn.losses import l1, over_valid_steps
from acgd.store.checkpoint import Generators
from acgd.store.stage import Inputs
from acgd.students.bc_rnn.mixture import Mixture, MixtureHead
from acgd.students.bc_rnn.settings import BCRNNConfig
from acgd.students.data import Batch, Data, Observation
from acgd.students.inputs import StudentInputs
from acgd.students.perception import Perception
from acgd.students.settings import ActingConfig, ImitationConfig
from acgd.students.student import Imitation, Sizes


class Hidden(NamedTuple):
    """The memory of the LSTM after a step."""

    short: Tensor
    """(B, layers, width): what the layers put out."""
    long: Tensor
    """(B, layers, width): their cells."""


class BCRNN(nn.Module):
    """Observations of consecutive steps -> an action for each, strictly inside the box."""

    def __init__(self, settings: BCRNNConfig, imitation: ImitationConfig, sizes: Sizes) -> None:
        super().__init__()
        self.settings, self.imitation, self.sizes = settings, imitation, sizes
        goal_image = imitation.goal_image != "off"
        self.inputs = StudentInputs(sizes, goal_image=goal_image)
        read = sizes.features * (2 if goal_image else 1) + sizes.proprio + sizes.tasks
        self.lstm = nn.LSTM(read, settings.width, settings.layers, batch_first=True)
        self.head = (
            MixtureHead(settings.width, sizes.actions, settings.modes, settings.least_std)
            if settings.head == "gmm"
            else nn.Linear(settings.width, sizes.actions)
        )

    def initialise(self, data: Data, inputs: Inputs) -> None:
        """Normalises its inputs by the demonstrations."""
        self.inputs.fit(data.windows)

    def prepare(self, data: Data, inputs: Inputs) -> dict[str, Tensor]:
        """The labels are the only targets."""
        return {}

    def forward(
        self,
        observation: Observation,
        hidden: Hidden | None = None,
        noise: float = 0.0,
        generator: torch.Generator | None = None,
    ) -> tuple[Tensor, Mixture | None, Hidden]:
        """Observations of L steps -> actions (B, L, A), for the head gmm their mixture, and the memory after them.

        Without `hidden` the memory before them is zero. Vision (B, L, ...), proprio (B, L, P), one goal and one task.
        """
        vision, goal, proprio = self.inputs(observation, noise, generator)
        steps = proprio.shape[1]
        given = [*([] if goal is None else [goal]), F.one_hot(observation.task, self.sizes.tasks).float()]
        read = torch.cat([vision, *(x[:, None].expand(-1, steps, -1) for x in given), proprio], dim=-1)
        before = None if hidden is None else tuple(x.transpose(0, 1).contiguous() for x in hidden)
        out, after = self.lstm(read, before)
        after = Hidden(*(x.transpose(0, 1) for x in after))
        if self.settings.head == "l1":
            return self.head(out).float().tanh(), None, after
        mixture = self.head(out)
        return mixture.likeliest(), mixture, after

    def imitate(self, batch: Batch, *, guided: int, noise: float, generators: Generators) -> Imitation:
        """The proposal is what the student would do at each step: a sample would guide modes that never act."""
        actions, mixture, _ = self(batch.observation, noise=noise, generator=generators["data"])
        loss = self.error(actions, mixture, batch)
        return Imitation(
            loss, actions[:guided] if guided else None, {"l_bc": loss, "l_act": self.l_act(actions, batch)}
        )

    def validate(self, batch: Batch) -> dict[str, Tensor]:
        """L_BC."""
        actions, mixture, _ = self(batch.observation)
        return {"validation_loss": self.error(actions, mixture, batch)}

    def error(self, actions: Tensor, mixture: Mixture | None, batch: Batch) -> Tensor:
        """L_BC: the mean over valid steps of -log p(a | o), or of the 1-norm of the error, (B, L, A) -> (B,)."""
        if mixture is None:
            return self.l_act(actions, batch)
        return over_valid_steps(-mixture.log_likelihood(batch.chunk, self.imitation.action_space), batch.mask)

    def l_act(self, actions: Tensor, batch: Batch) -> Tensor:
        """The mean over valid steps of the 1-norm of the error, (B, L, A) -> (B,)."""
        space = self.imitation.action_space
        return l1(to_loss_space(actions, space), to_loss_space(batch.chunk, space), batch.mask)

    @torch.no_grad()
    def plan(self, observation: Observation) -> Tensor:
        """The action at each step of a window whose memory starts at zero, (B, L, A)."""
        return self(observation)[0]

    def policy(self, perception: Perception, acting: ActingConfig) -> "RecurrentPolicy":
        """Acts step by step. `acting` is for chunks, and there are none."""
        return RecurrentPolicy(self, perception)


class Memory(NamedTuple):
    """What a policy carries from step to step, a row per environment. Rows never mix."""

    task: np.ndarray
    """(n,) int64."""
    goal: np.ndarray | None
    """(n, F), or (n, H, W, 3) uint8 where the student owns its CNN."""
    hidden: Hidden
    steps: np.ndarray
    """(n,) int64, actions taken so far."""


class RecurrentPolicy:
    """One action a step, from the current observation and the memory of those before it.

    The mixture's action is the mean of its likeliest mode. robomimic draws a mode and adds noise of 1e-4: with the mean
    an episode depends on its seed alone, and no episode changes modes from step to step by chance.
    """

    def __init__(self, student: BCRNN, perception: Perception) -> None:
        self.student, self.perception = student.eval(), perception

    def start(self, tasks: np.ndarray, goals: np.ndarray | None, seeds: list[int]) -> Memory:
        """tasks (n,), goal images (n, H, W, 3) uint8 or None. It draws nothing, and so ignores the seeds."""
        n, settings = len(tasks), self.student.settings
        zeros = torch.zeros(n, settings.layers, settings.width, device=self.perception.device)
        given = np.asarray(tasks, np.int64), self.perception.see_goals(goals)
        return Memory(*given, Hidden(zeros, zeros), np.zeros(n, np.int64))

    @torch.inference_mode()
    def act(self, obs: Mapping[str, np.ndarray], memory: Memory) -> tuple[np.ndarray, Memory]:
        """obs: image (n, H, W, 3) uint8, proprio (n, P) -> actions (n, A) float32 in the box, and the next memory."""
        tensor, settings = self.perception.tensor, self.student.settings
        proprio = np.asarray(obs["proprio"], np.float32)[:, None]
        vision = self.perception.see(obs["image"])[:, None]
        seen = Observation(vision, tensor(memory.goal), tensor(proprio), tensor(memory.task))
        hidden = memory.hidden
        if settings.reset:
            goes_on = tensor(memory.steps % settings.sequence != 0)[:, None, None]
            hidden = Hidden(*(torch.where(goes_on, x, 0.0) for x in hidden))
        actions, _, hidden = self.student(seen, hidden)
        return actions[:, 0].cpu().numpy(), memory._replace(hidden=hidden, steps=memory.steps + 1)
