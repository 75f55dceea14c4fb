"""pi_theta, the visual multi-task student (Figure 2b): observer, phi_lat, frozen codes, psi_dec."""

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any, Self

import torch
from safetensors.torch import load_file, save_file
from torch import Tensor, nn

from acgd.nn.excitation import to_loss_space
from acgd.students import quantizer
from acgd.students.codebook import Codebook, Sizes
from acgd.students.decoder import Decoder
from acgd.students.latent_encoder import LatentEncoder
from acgd.students.observer import Observation, Observer
from acgd.students.quantizer import Quantizer
from acgd.students.settings import CodebookConfig

META = "student.json"


class Student(nn.Module):
    """Observation -> codes -> action chunk. Built from a codebook, whose codes it keeps and whose decoder it goes on training."""

    def __init__(self, config: CodebookConfig, sizes: Sizes) -> None:
        super().__init__()
        self.config, self.sizes = config, sizes
        self.observer = Observer(
            sizes.features,
            sizes.proprio,
            config.history,
            sizes.tasks,
            config.width,
            config.expansion,
            config.goal_image != "off",
            sizes.owns_cnn,
        )
        self.latent_encoder = LatentEncoder(config.width, config.expansion, config.groups, config.codes)
        self.quantizer = Quantizer(config.groups, config.codes, config.width).requires_grad_(False)
        self.decoder = Decoder(
            config.chunk, sizes.actions, config.width, config.heads, config.decoder_layers, config.expansion
        )

    @classmethod
    def of(cls, codebook: Codebook) -> Self:
        """Observer, codes and decoder as the codebook left them; phi_lat fresh from torch's global generator."""
        student = cls(codebook.config, codebook.sizes)
        for part in ("observer", "quantizer", "decoder"):
            getattr(student, part).load_state_dict(getattr(codebook, part).state_dict())
        return student

    def measured(self, action: Tensor) -> Tensor:
        """Actions in the space in which they are compared."""
        return to_loss_space(action, self.config.action_space)

    @torch.no_grad()
    def plan(self, features: Tensor, goal_features: Tensor | None, proprio_history: Tensor, task: Tensor) -> Tensor:
        """features, goal_features (B, F), or images (B, H, W, 3) uint8 for a student with its own CNN; proprio_history (B, h, P), oldest
        first; task (B,) -> chunk (B, k, A) strictly inside the box, from the likeliest codes.
        """
        z_state, z_task = self.observer(Observation(features, goal_features, proprio_history, task))
        onehot, _ = quantizer.most_likely(self.latent_encoder(z_state, z_task))
        return self.decoder(self.quantizer.embed(onehot), z_state, z_task)

    def save(self, directory: Path, weights: dict[str, dict[str, Tensor]], notes: dict[str, Any]) -> None:
        """`weights`: name -> state dict, each its own file; sizes and `notes` as JSON."""
        for name, tensors in weights.items():
            save_file({key: value.contiguous() for key, value in tensors.items()}, directory / f"{name}.safetensors")
        meta = {"codebook": self.config.model_dump(mode="json"), "sizes": asdict(self.sizes), **notes}
        (directory / META).write_text(json.dumps(meta, indent=1, sort_keys=True) + "\n")

    @classmethod
    def load(cls, directory: Path, weights: str, device: torch.device) -> Self:
        """weights: best (least validation loss) or last."""
        meta = json.loads((Path(directory) / META).read_text())
        student = cls(CodebookConfig(**meta["codebook"]), Sizes(**meta["sizes"]))
        student.load_state_dict(load_file(Path(directory) / f"{weights}.safetensors"))
        return student.to(device).eval()
