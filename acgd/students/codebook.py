"""The action codebook, stage (a) of Figure 2: phi_act, the quantizer, psi_dec, and the observer that psi_dec is conditioned on."""

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Self

import torch
from safetensors.torch import load_file, save_file
from torch import Tensor, nn

from acgd.nn.excitation import to_loss_space
from acgd.students import quantizer
from acgd.students.action_encoder import ActionEncoder
from acgd.students.decoder import Decoder
from acgd.students.observer import Observer
from acgd.students.quantizer import Quantizer
from acgd.students.settings import CodebookConfig

WEIGHTS, META = "codebook.safetensors", "codebook.json"


@dataclass(frozen=True)
class Sizes:
    """What the data dictate."""

    features: int
    proprio: int
    actions: int
    tasks: int
    owns_cnn: bool


class Codebook(nn.Module):
    """a_{t:t+k} -> codes -> a_hat_{t:t+k}, given z_state and z_task."""

    def __init__(self, config: CodebookConfig, sizes: Sizes) -> None:
        super().__init__()
        self.config, self.sizes = config, sizes
        width, heads, expansion = config.width, config.heads, config.expansion
        self.observer = Observer(
            sizes.features,
            sizes.proprio,
            config.history,
            sizes.tasks,
            width,
            expansion,
            config.goal_image != "off",
            sizes.owns_cnn,
        )
        self.quantizer = Quantizer(config.groups, config.codes, width, config.logits == "distance")
        self.action_encoder = ActionEncoder(
            config.chunk,
            sizes.actions,
            width,
            heads,
            config.encoder_layers,
            expansion,
            config.groups,
            self.quantizer.encoding_size,
        )
        self.decoder = Decoder(config.chunk, sizes.actions, width, heads, config.decoder_layers, expansion)

    def measured(self, action: Tensor) -> Tensor:
        """Actions in the space in which they are encoded and compared."""
        return to_loss_space(action, self.config.action_space)

    def encode(self, chunk: Tensor, mask: Tensor) -> Tensor:
        """chunk (B, k, A), mask (B, k) -> logits of phi_act (B, G, n_c)."""
        return self.quantizer.logits(self.action_encoder(self.measured(chunk), mask))

    @torch.no_grad()
    def codes(self, chunk: Tensor, mask: Tensor) -> Tensor:
        """The likeliest codes of a chunk, stage (b)'s targets -> (B, G)."""
        return quantizer.most_likely(self.encode(chunk, mask))[1]

    def save(self, directory: Path) -> None:
        """Weights as safetensors, configuration and sizes as JSON."""
        save_file({name: value.contiguous() for name, value in self.state_dict().items()}, directory / WEIGHTS)
        meta = {"codebook": self.config.model_dump(mode="json"), "sizes": asdict(self.sizes)}
        (directory / META).write_text(json.dumps(meta, indent=1, sort_keys=True) + "\n")

    @classmethod
    def load(cls, directory: Path, device: torch.device) -> Self:
        """A codebook as it was saved, in eval mode."""
        meta = json.loads((Path(directory) / META).read_text())
        codebook = cls(CodebookConfig(**meta["codebook"]), Sizes(**meta["sizes"]))
        codebook.load_state_dict(load_file(Path(directory) / WEIGHTS))
        return codebook.to(device).eval()
