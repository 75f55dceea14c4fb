"""The networks of Figure 2: phi_act and phi_lat, and all of them as codebook (a) and student (b).

Sizes: B windows; k actions of A components in a chunk; G groups of n_c codes; d, the width of every embedding. The
quantizer C and z_q are in quantizer.py, the losses in losses.py. phi_state, phi_task and psi_dec are in observer.py
and decoder.py of acgd/students, which other students share.
"""

import json
from dataclasses import asdict
from pathlib import Path
from typing import Self

import torch
from safetensors.torch import load_file, save_file
from torch import Tensor, nn

from acgd.nn.block import Block
from acgd.nn.excitation import to_loss_space
from acgd.rollouts.windows import Windows
from acgd.store.checkpoint import Generators
from acgd.store.key import in_key
from acgd.store.stage import Inputs
from acgd.students.acgd import losses, quantizer
from acgd.students.acgd.quantizer import Quantizer
from acgd.students.acgd.settings import ACGDConfig
from acgd.students.acting import ChunkPolicy
from acgd.students.data import Batch, Data, Observation
from acgd.students.decoder import ActionDecoder
from acgd.students.errors import l1_error
from acgd.students.observer import Observer
from acgd.students.settings import ActingConfig, ImitationConfig
from acgd.students.student import Imitation, Sizes

WEIGHTS, META = "codebook.safetensors", "codebook.json"
ENCODED_AT_ONCE = 1024
"""Windows."""


class ActionEncoder(nn.Module):
    """phi_act, a transformer over the action chunk: a_{t:t+k} -> z_e (Section III-A)."""

    def __init__(self, settings: ACGDConfig, sizes: Sizes, encoding_size: int) -> None:
        """encoding_size: number of values of z_e per group."""
        super().__init__()
        s = settings
        self.embed = nn.Linear(sizes.actions, s.width)
        self.past_the_end = nn.Parameter(torch.randn(s.width) * 0.02)
        self.position = nn.Parameter(torch.randn(s.chunk, s.width) * 0.02)
        self.blocks = nn.ModuleList(Block(s.width, s.heads, s.expansion) for _ in range(s.encoder_layers))
        self.norm = nn.LayerNorm(s.width)
        self.head = nn.Linear(s.chunk * s.width, s.groups * encoding_size)
        self.groups = s.groups

    def forward(self, chunk: Tensor, mask: Tensor) -> Tensor:
        """chunk (B, k, A), mask (B, k) true on steps inside the episode -> z_e (B, G, encoding_size)."""
        tokens = torch.where(mask[..., None], self.embed(chunk), self.past_the_end) + self.position
        for block in self.blocks:
            tokens = block(tokens)
        return self.head(self.norm(tokens).flatten(1)).unflatten(-1, (self.groups, -1))


class LatentEncoder(nn.Module):
    """phi_lat, an MLP: z_state, z_task -> logits of the codes (Figure 2b)."""

    def __init__(self, settings: ACGDConfig) -> None:
        super().__init__()
        width, hidden = settings.width, settings.expansion * settings.width
        self.net = nn.Sequential(
            nn.LayerNorm(2 * width),
            nn.Linear(2 * width, hidden),
            nn.ReLU(),
            nn.Linear(hidden, hidden),
            nn.ReLU(),
            nn.Linear(hidden, settings.groups * settings.codes),
        )
        self.groups = settings.groups

    def forward(self, z_state: Tensor, z_task: Tensor) -> Tensor:
        """Each (B, d) -> logits (B, G, n_c)."""
        return self.net(torch.cat([z_state, z_task], dim=-1)).unflatten(-1, (self.groups, -1))


class Codebook(nn.Module):
    """Stage (a) of Figure 2: a_{t:t+k} -> codes -> a_hat_{t:t+k}, given z_state and z_task."""

    def __init__(self, settings: ACGDConfig, imitation: ImitationConfig, sizes: Sizes) -> None:
        super().__init__()
        self.settings, self.imitation, self.sizes = settings, imitation, sizes
        self.observer = Observer(settings, imitation, sizes)
        self.quantizer = Quantizer(settings)
        self.action_encoder = ActionEncoder(settings, sizes, self.quantizer.encoding_size)
        self.decoder = ActionDecoder(settings, sizes)

    def encode(self, chunk: Tensor, mask: Tensor) -> Tensor:
        """chunk (B, k, A), mask (B, k) -> logits of phi_act (B, G, n_c)."""
        chunk = to_loss_space(chunk, self.imitation.action_space)
        return self.quantizer.logits(self.action_encoder(chunk, mask))

    def decode(self, onehot: Tensor, z_state: Tensor, z_task: Tensor) -> Tensor:
        """onehot (B, G, n_c), embeddings (B, d) -> action chunk (B, k, A)."""
        return self.decoder(self.quantizer.embed(onehot), z_state, z_task)

    @torch.no_grad()
    def codes_of(self, windows: Windows) -> Tensor:
        """The likeliest codes of phi_act for the window at every step -> (N, G)."""
        every = torch.arange(len(windows.task), device=windows.task.device)
        chunks = (windows.chunk_of("label", t, self.settings.chunk) for t in every.split(ENCODED_AT_ONCE))
        return torch.cat([quantizer.most_likely(self.encode(*chunk))[1] for chunk in chunks])

    def save(self, directory: Path) -> None:
        """Writes the weights as safetensors, settings and sizes as JSON."""
        save_file({name: value.contiguous() for name, value in self.state_dict().items()}, directory / WEIGHTS)
        meta = {
            "student": in_key(self.settings),
            "imitation": in_key(self.imitation),
            "sizes": asdict(self.sizes),
        }
        (directory / META).write_text(json.dumps(meta, indent=1, sort_keys=True) + "\n")

    @classmethod
    def load(cls, directory: Path, device: torch.device) -> Self:
        """Loads a saved codebook in evaluation mode."""
        meta = json.loads((Path(directory) / META).read_text())
        codebook = cls(ACGDConfig(**meta["student"]), ImitationConfig(**meta["imitation"]), Sizes(**meta["sizes"]))
        codebook.load_state_dict(load_file(Path(directory) / WEIGHTS))
        return codebook.to(device).eval()


class ACGD(nn.Module):
    """pi_theta, stage (b) of Figure 2: observation -> codes -> action chunk.

    The codes of the codebook stay fixed. Its observer and decoder are trained further. phi_act's codes are the targets
    of phi_lat.
    """

    def __init__(self, settings: ACGDConfig, imitation: ImitationConfig, sizes: Sizes) -> None:
        super().__init__()
        self.settings, self.imitation, self.sizes = settings, imitation, sizes
        self.observer = Observer(settings, imitation, sizes)
        self.latent_encoder = LatentEncoder(settings)
        self.quantizer = Quantizer(settings).requires_grad_(False)
        self.decoder = ActionDecoder(settings, sizes)

    def initialise(self, data: Data, inputs: Inputs) -> None:
        """Loads observer, codes and decoder from the codebook. phi_lat keeps its random weights."""
        codebook = Codebook.load(inputs["codebook"], self.quantizer.codes.device)
        for part in ("observer", "quantizer", "decoder"):
            getattr(self, part).load_state_dict(getattr(codebook, part).state_dict())

    def prepare(self, data: Data, inputs: Inputs) -> dict[str, Tensor]:
        """The target `codes` (N, G): phi_act's codes of every window."""
        return {"codes": Codebook.load(inputs["codebook"], self.quantizer.codes.device).codes_of(data.windows)}

    def imitate(self, batch: Batch, *, guided: int, noise: float, generators: Generators) -> Imitation:
        """L_BC = L_lat + L_act (Section III-C).

        L_act decodes phi_act's code. The proposal decodes a straight-through sample of phi_lat. Both pass the decoder
        in one batch.
        """
        codes = batch.targets["codes"]
        z_state, z_task = self.observer(batch.observation, noise, generators["data"])
        logits = self.latent_encoder(z_state, z_task)
        l_lat = losses.lat(logits, codes)
        z_q = self.quantizer.embed(quantizer.onehot(codes, self.settings.codes))
        if guided:
            sampled, _ = quantizer.sample(logits[:guided], generators["sample"])
            z_q = torch.cat([z_q, self.quantizer.embed(sampled)])
            z_state, z_task = torch.cat([z_state, z_state[:guided]]), torch.cat([z_task, z_task[:guided]])
        decoded = self.decoder(z_q, z_state, z_task)
        l_act = self.error(decoded[: len(codes)], batch)
        proposal = decoded[len(codes) :] if guided else None
        return Imitation(l_lat + l_act, proposal, {"l_lat": l_lat, "l_act": l_act})

    def validate(self, batch: Batch) -> dict[str, Tensor]:
        """L_BC, its parts, and the share of groups in which phi_lat's likeliest code equals phi_act's; each (B,)."""
        codes = batch.targets["codes"]
        z_state, z_task = self.observer(batch.observation)
        logits = self.latent_encoder(z_state, z_task)
        l_lat = losses.lat(logits, codes)
        z_q = self.quantizer.embed(quantizer.onehot(codes, self.settings.codes))
        l_act = self.error(self.decoder(z_q, z_state, z_task), batch)
        return {
            "validation_loss": l_lat + l_act,
            "validation_l_lat": l_lat,
            "validation_l_act": l_act,
            "validation_code_accuracy": (quantizer.most_likely(logits)[1] == codes).float().mean(-1),
        }

    def error(self, decoded: Tensor, batch: Batch) -> Tensor:
        """L_act of each window, (B, k, A) -> (B,)."""
        return l1_error(decoded, batch, self.imitation.action_space)

    @torch.no_grad()
    def plan(self, observation: Observation) -> Tensor:
        """The chunk (B, k, A) of the likeliest codes."""
        z_state, z_task = self.observer(observation)
        onehot, _ = quantizer.most_likely(self.latent_encoder(z_state, z_task))
        return self.decoder(self.quantizer.embed(onehot), z_state, z_task)

    @torch.no_grad()
    def margin(self, observation: Observation) -> Tensor:
        """By how much the likeliest code leads, in the group where that is least, (B,)."""
        first, second = self.latent_encoder(*self.observer(observation)).topk(2).values.unbind(-1)
        return (first - second).amin(-1)

    def policy(self, acting: ActingConfig) -> ChunkPolicy:
        """A policy that acts from the student's chunks."""
        return ChunkPolicy(self, acting)
