"""Recurrent behaviour cloning (robomimic's BC-RNN): an LSTM over observations -> an action at each step.

A window has `sequence` observations from step t on, each with its action. The memory is zero at t, so the j-th action
of a window depends on j + 1 observations. A policy that resets its memory every `sequence` steps is in the same states:
the error of `plan`, a mean over the steps of a window, is the error of its actions. Guidance judges the action of every
step in the state of that step.

Sizes: B windows; L observations in a row, k = `sequence` in a window; A action components.
"""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional as F

from acgd.nn.losses import over_valid_steps
from acgd.store.checkpoint import Generators
from acgd.store.stage import Inputs
from acgd.students.acting import to_observation
from acgd.students.bc_rnn.mixture import Mixture, MixtureHead
from acgd.students.bc_rnn.settings import BCRNNConfig
from acgd.students.data import Batch, Data, Observation
from acgd.students.errors import l1_error
from acgd.students.inputs import StudentInputs
from acgd.students.settings import ActingConfig, ImitationConfig
from acgd.students.student import Imitation, Sizes


class Hidden(NamedTuple):
    """State of the LSTM after a step."""

    short: Tensor
    """(B, layers, width), outputs of the layers."""
    long: Tensor
    """(B, layers, width), cells of the layers."""


class BCRNN(nn.Module):
    """Observations of consecutive steps -> an action for each step in (-1, 1)^A."""

    def __init__(self, settings: BCRNNConfig, imitation: ImitationConfig, sizes: Sizes) -> None:
        super().__init__()
        self.settings, self.imitation, self.sizes = settings, imitation, sizes
        self.inputs = StudentInputs(imitation, sizes)
        read = self.inputs.width + sizes.proprio + sizes.tasks
        self.lstm = nn.LSTM(read, settings.width, settings.layers, batch_first=True)
        self.head = (
            MixtureHead(settings.width, sizes.actions, settings.modes, settings.least_std)
            if settings.head == "gmm"
            else nn.Linear(settings.width, sizes.actions)
        )

    def initialise(self, data: Data, inputs: Inputs) -> None:
        """Fits the normalisers of the inputs to the demonstrations."""
        self.inputs.fit(data.windows)

    def prepare(self, data: Data, inputs: Inputs) -> dict[str, Tensor]:
        """Returns no further targets: the labels are the only ones."""
        return {}

    def forward(
        self,
        observation: Observation,
        hidden: Hidden | None = None,
        noise: float = 0.0,
        generator: torch.Generator | None = None,
    ) -> tuple[Tensor, Mixture | None, Hidden]:
        """Observations of L steps -> actions (B, L, A), their mixture (head gmm only), and the state after them.

        observation: vision (B, L, ...), proprio (B, L, P), and one goal and one task per window. hidden: the state
        before the first step, None for zero. noise: standard deviation on the normalised inputs.
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
        """L_BC as in `error`. The proposal is the action of each step, since modes that are not chosen never act."""
        actions, mixture, _ = self(batch.observation, noise=noise, generator=generators["data"])
        loss = self.error(actions, mixture, batch)
        return Imitation(
            loss, actions[:guided] if guided else None, {"l_bc": loss, "l_act": self.l_act(actions, batch)}
        )

    def validate(self, batch: Batch) -> dict[str, Tensor]:
        """L_BC (B,)."""
        actions, mixture, _ = self(batch.observation)
        return {"validation_loss": self.error(actions, mixture, batch)}

    def error(self, actions: Tensor, mixture: Mixture | None, batch: Batch) -> Tensor:
        """L_BC (B,): mean over valid steps of -log p(a | o), or of the 1-norm of the error. actions (B, L, A)."""
        if mixture is None:
            return self.l_act(actions, batch)
        return over_valid_steps(-mixture.log_likelihood(batch.chunk, self.imitation.action_space), batch.mask)

    def l_act(self, actions: Tensor, batch: Batch) -> Tensor:
        """Mean over valid steps of the 1-norm of the error: actions (B, L, A) -> (B,)."""
        return l1_error(actions, batch, self.imitation.action_space)

    @torch.no_grad()
    def plan(self, observation: Observation) -> Tensor:
        """The actions (B, L, A) at the steps of a window. The memory is zero before its first step."""
        return self(observation)[0]

    def policy(self, acting: ActingConfig) -> "RecurrentPolicy":
        """A policy that acts step by step. It ignores `acting`, which is for chunks."""
        return RecurrentPolicy(self)

    def stepping(self, acting: ActingConfig) -> "RecurrentStep":
        """The function of the policy as a module, for acgd/export/onnx/stepping.py."""
        return RecurrentStep(self)


def _reset(hidden: Hidden, steps: Tensor, settings: BCRNNConfig) -> Hidden:
    """The state before a step. With the setting `reset` it is zero every `sequence` steps of an episode.

    steps (B,): actions taken so far.
    """
    if not settings.reset:
        return hidden
    kept = (steps % settings.sequence != 0)[:, None, None]
    return Hidden(*(torch.where(kept, x, 0.0) for x in hidden))


class Memory(NamedTuple):
    """State of the policy between steps, one row per environment. Rows are independent."""

    task: np.ndarray
    """(n,) int64."""
    goal: np.ndarray | None
    """(n, ...) in the form of Observation. None: no goal."""
    hidden: Hidden
    """State of the LSTM of each environment."""
    steps: np.ndarray
    """(n,) int64, actions taken so far."""


class RecurrentPolicy:
    """Policy of BC-RNN: one action per step, from the current observation and the memory of earlier ones.

    The action of a mixture is the mean of its likeliest mode. robomimic draws a mode and adds noise of 1e-4. With the
    mean an episode depends on its seed only, and the mode does not change from step to step by chance.
    """

    def __init__(self, student: BCRNN) -> None:
        self.student, self.device = student.eval(), next(student.parameters()).device

    def start(self, tasks: np.ndarray, goals: np.ndarray | None, seeds: list[int]) -> Memory:
        """tasks (n,), goals in the form of Observation or None. The policy ignores `seeds`: it is deterministic."""
        n, settings = len(tasks), self.student.settings
        zeros = torch.zeros(n, settings.layers, settings.width, device=self.device)
        return Memory(np.asarray(tasks, np.int64), goals, Hidden(zeros, zeros), np.zeros(n, np.int64))

    @torch.inference_mode()
    def act(self, obs: Mapping[str, np.ndarray], memory: Memory) -> tuple[np.ndarray, Memory]:
        """obs: vision as in Observation, proprio (n, P) -> actions (n, A) float32 in the box, and the next memory."""
        proprio = np.asarray(obs["proprio"], np.float32)[:, None]
        observation = to_observation(obs["vision"][:, None], memory.goal, proprio, memory.task, self.device)
        hidden = _reset(memory.hidden, torch.as_tensor(memory.steps, device=self.device), self.student.settings)
        actions, _, hidden = self.student(observation, hidden)
        return actions[:, 0].cpu().numpy(), memory._replace(hidden=hidden, steps=memory.steps + 1)


class RecurrentStep(nn.Module):
    """RecurrentPolicy as a function of tensors for one step: see acgd/export/onnx/stepping.py."""

    def __init__(self, student: BCRNN) -> None:
        super().__init__()
        self.student = student
        shape = (student.settings.layers, student.settings.width)
        self.memory = {name: (shape, torch.float32) for name in Hidden._fields}

    def run(
        self, vision: Tensor, goal: Tensor | None, proprio: Tensor, task: Tensor, memory: dict[str, Tensor]
    ) -> tuple[Tensor, Mixture | None, Hidden]:
        """As BCRNN.forward with L = 1."""
        hidden = _reset(Hidden(memory["short"], memory["long"]), memory["steps"], self.student.settings)
        return self.student(Observation(vision[:, None], goal, proprio[:, None], task), hidden)

    def forward(self, *step) -> tuple[Tensor, dict[str, Tensor]]:
        """Arguments of `run` -> actions (B, A), next memory."""
        actions, _, hidden = self.run(*step)
        return actions[:, 0], hidden._asdict()

    def margin(self, *step) -> Tensor:
        """Arguments of `run` -> lead of the likeliest mode (B,)."""
        actions, mixture, _ = self.run(*step)
        if mixture is None or self.student.settings.modes == 1:
            return actions.new_full((len(actions),), torch.inf)
        first, second = mixture.logits[:, 0].topk(2).values.unbind(-1)
        return first - second
