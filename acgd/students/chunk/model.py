"""An L1 chunk: phi_state, phi_task and psi_dec of acgd, without z_q."""

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
from acgd.students.perception import Perception
from acgd.students.settings import ActingConfig, ImitationConfig
from acgd.students.student import Imitation, Sizes


class Chunk(nn.Module):
    """Observation -> action chunk, strictly inside the box."""

    def __init__(self, settings: ChunkConfig, imitation: ImitationConfig, sizes: Sizes) -> None:
        super().__init__()
        self.settings, self.imitation, self.sizes = settings, imitation, sizes
        self.observer = Observer(settings, imitation, sizes)
        self.decoder = ActionDecoder(settings, sizes)

    def initialise(self, data: Data, inputs: Inputs) -> None:
        """Normalises its inputs by the demonstrations."""
        self.observer.inputs.fit(data.windows)

    def prepare(self, data: Data, inputs: Inputs) -> dict[str, Tensor]:
        """The labels are the only targets."""
        return {}

    def forward(self, observation: Observation, noise: float = 0.0, generator: torch.Generator | None = None) -> Tensor:
        """-> (B, k, A)."""
        return self.decoder(*self.observer(observation, noise, generator))

    def imitate(self, batch: Batch, *, guided: int, noise: float, generators: Generators) -> Imitation:
        """L_BC = L_act. The proposal is the imitating chunk itself."""
        chunk = self(batch.observation, noise, generators["data"])
        l_act = l1_error(chunk, batch, self.imitation.action_space)
        return Imitation(l_act, chunk[:guided] if guided else None, {"l_act": l_act})

    def validate(self, batch: Batch) -> dict[str, Tensor]:
        """L_BC."""
        return {"validation_loss": l1_error(self(batch.observation), batch, self.imitation.action_space)}

    @torch.no_grad()
    def plan(self, observation: Observation) -> Tensor:
        """(B, k, A)."""
        return self(observation)

    def policy(self, perception: Perception, acting: ActingConfig) -> ChunkPolicy:
        """Acts by its chunks."""
        return ChunkPolicy(self, perception, acting)
