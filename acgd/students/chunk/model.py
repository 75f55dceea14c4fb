"""A chunk without codes: phi_state, phi_task and psi_dec of acgd, without z_q, with an L1 loss."""

import torch
from torch import Tensor, nn

from acgd.store.checkpoint import Generators
from acgd.store.stage import Inputs
from acgd.students.acting import ChunkPolicy
from acgd.students.chunk.settings import ChunkConfig
from acgd.students.data import Batch, Data, Observation
from acgd.students.decoder import ActionDecoder
from acgd.students.errors import l1_error
from acgd.students.observer import Observer
from acgd.students.settings import ActingConfig, ImitationConfig
from acgd.students.student import Imitation, Sizes


class Chunk(nn.Module):
    """Observation -> action chunk in (-1, 1)^A."""

    def __init__(self, settings: ChunkConfig, imitation: ImitationConfig, sizes: Sizes) -> None:
        super().__init__()
        self.settings, self.imitation, self.sizes = settings, imitation, sizes
        self.observer = Observer(settings, imitation, sizes)
        self.decoder = ActionDecoder(settings, sizes)

    def initialise(self, data: Data, inputs: Inputs) -> None:
        """Fits the normalisers of the inputs to the demonstrations."""
        self.observer.inputs.fit(data.windows)

    def prepare(self, data: Data, inputs: Inputs) -> dict[str, Tensor]:
        """Returns no further targets: the labels are the only ones."""
        return {}

    def forward(self, observation: Observation, noise: float = 0.0, generator: torch.Generator | None = None) -> Tensor:
        """The chunk (B, k, A). noise: standard deviation on the normalised inputs."""
        return self.decoder(*self.observer(observation, noise, generator))

    def imitate(self, batch: Batch, *, guided: int, noise: float, generators: Generators) -> Imitation:
        """L_BC = L_act. The proposal is the same chunk."""
        chunk = self(batch.observation, noise, generators["data"])
        l_act = l1_error(chunk, batch, self.imitation.action_space)
        return Imitation(l_act, chunk[:guided] if guided else None, {"l_act": l_act})

    def validate(self, batch: Batch) -> dict[str, Tensor]:
        """L_BC (B,)."""
        return {"validation_loss": l1_error(self(batch.observation), batch, self.imitation.action_space)}

    @torch.no_grad()
    def plan(self, observation: Observation) -> Tensor:
        """The chunk (B, k, A)."""
        return self(observation)

    def policy(self, acting: ActingConfig) -> ChunkPolicy:
        """A policy that acts from the student's chunks."""
        return ChunkPolicy(self, acting)
