"""ACT (Zhao et al. 2023): a CVAE. In training its style encoder reads the labels; a policy plans with z = 0.

Sizes: B windows; k actions of A components in a chunk; d, the width of every embedding; L components of z; m tokens of
an observation. Readings of the paper: docs/deviations.md.
"""

import torch
from torch import Tensor, nn

from acgd.nn.block import Block
from acgd.nn.excitation import to_loss_space
from acgd.store.checkpoint import Generators
from acgd.store.stage import Inputs
from acgd.students.act import losses
from acgd.students.act.settings import ACTConfig
from acgd.students.acting import ChunkPolicy
from acgd.students.data import Batch, Data, Observation
from acgd.students.decoder import ActionDecoder
from acgd.students.errors import l1_error
from acgd.students.inputs import Normalised, StudentInputs
from acgd.students.settings import ActingConfig, ImitationConfig
from acgd.students.student import Imitation, Sizes


class StyleEncoder(nn.Module):
    """q(z | s_t, a_{t:t+k}), a transformer over [CLS, proprioception, action chunk]. Only training uses it."""

    def __init__(self, settings: ACTConfig, sizes: Sizes) -> None:
        super().__init__()
        s = settings
        self.cls = nn.Parameter(torch.randn(1, s.width) * 0.02)
        self.proprio = nn.Linear(sizes.proprio, s.width)
        self.action = nn.Linear(sizes.actions, s.width)
        self.past_the_end = nn.Parameter(torch.randn(s.width) * 0.02)
        self.position = nn.Parameter(torch.randn(2 + s.chunk, s.width) * 0.02)
        self.blocks = nn.ModuleList(Block(s.width, s.heads, s.expansion) for _ in range(s.style_layers))
        self.norm = nn.LayerNorm(s.width)
        self.head = nn.Linear(s.width, 2 * s.latent)

    def forward(self, proprio: Tensor, chunk: Tensor, mask: Tensor) -> tuple[Tensor, Tensor]:
        """Current proprio (B, P), normalised; chunk (B, k, A); mask (B, k) -> mean and log variance of z, (B, L)."""
        actions = torch.where(mask[..., None], self.action(chunk), self.past_the_end)
        cls = self.cls.expand(len(chunk), -1, -1)
        tokens = torch.cat([cls, self.proprio(proprio)[:, None], actions], dim=1) + self.position
        for block in self.blocks:
            tokens = block(tokens)
        return self.head(self.norm(tokens[:, 0])).float().chunk(2, dim=-1)


class ObservationTokens(nn.Module):
    """Tokens of vision, the proprioceptive history, the task and, if it is used, the goal.

    One token holds the features of o_t and of earlier frames. Each kind of token has its own linear layer, whose bias
    distinguishes it from the other kinds.
    """

    def __init__(self, settings: ACTConfig, sizes: Sizes, inputs: StudentInputs) -> None:
        super().__init__()
        self.vision = nn.Linear(inputs.vision_width, settings.width)
        self.goal = nn.Linear(inputs.goal_width, settings.width) if inputs.uses_goal else None
        self.proprio = nn.Linear(settings.history * sizes.proprio, settings.width)
        self.task = nn.Embedding(sizes.tasks, settings.width)

    def forward(self, seen: Normalised, task: Tensor) -> Tensor:
        """Normalised inputs, task (B,) -> tokens (B, m, d)."""
        tokens = [self.vision(seen.vision), self.proprio(seen.proprio.flatten(1)), self.task(task)]
        return torch.stack(tokens if self.goal is None else [*tokens, self.goal(seen.goal)], dim=1)


class ACT(nn.Module):
    """Observation, z -> action chunk in (-1, 1)^A."""

    def __init__(self, settings: ACTConfig, imitation: ImitationConfig, sizes: Sizes) -> None:
        super().__init__()
        s = settings
        self.settings, self.imitation, self.sizes = settings, imitation, sizes
        self.inputs = StudentInputs(imitation, sizes)
        self.style_encoder = StyleEncoder(s, sizes)
        self.tokens = ObservationTokens(s, sizes, self.inputs)
        self.latent = nn.Linear(s.latent, s.width)
        self.encoder = nn.ModuleList(Block(s.width, s.heads, s.expansion) for _ in range(s.encoder_layers))
        self.decoder = ActionDecoder(s, sizes)

    def initialise(self, data: Data, inputs: Inputs) -> None:
        """Fits the normalisers of the inputs to the demonstrations."""
        self.inputs.fit(data.windows)

    def prepare(self, data: Data, inputs: Inputs) -> dict[str, Tensor]:
        """Returns no further targets: the labels are the only ones."""
        return {}

    def posterior(self, seen: Normalised, batch: Batch) -> tuple[Tensor, Tensor]:
        """Mean and log variance of z given the labels, each (B, L)."""
        chunk = to_loss_space(batch.chunk, self.imitation.action_space)
        return self.style_encoder(seen.proprio[:, -1], chunk, batch.mask)

    def decode(self, z: Tensor, tokens: Tensor) -> Tensor:
        """z (B, L), tokens of the observation (B, m, d) -> action chunk (B, k, A)."""
        tokens = torch.cat([self.latent(z)[:, None], tokens], dim=1)
        for block in self.encoder:
            tokens = block(tokens)
        return self.decoder(*tokens.unbind(1))

    def imitate(self, batch: Batch, *, guided: int, noise: float, generators: Generators) -> Imitation:
        """L_BC = L_act + A w L_kl. w is the weight of the KL divergence against the error of one action component.

        L_act decodes a sample of the posterior. The proposal decodes a sample of the prior, since the posterior depends
        on the labels, which a policy does not have. With a sample instead of the mean, guidance improves the whole
        distribution of chunks, as in acgd; z = 0 belongs to it.
        """
        seen = self.inputs(batch.observation, noise, generators["data"])
        mean, log_variance = self.posterior(seen, batch)
        z, tokens = losses.sample(mean, log_variance, generators["data"]), self.tokens(seen, batch.observation.task)
        if guided:
            prior = torch.randn(guided, z.shape[-1], generator=generators["sample"], device=z.device)
            z, tokens = torch.cat([z, prior]), torch.cat([tokens, tokens[:guided]])
        decoded = self.decode(z, tokens)
        l_act, l_kl = self.terms(decoded[: len(mean)], mean, log_variance, batch)
        proposal = decoded[len(mean) :] if guided else None
        return Imitation(self.l_bc(l_act, l_kl), proposal, {"l_act": l_act, "l_kl": l_kl})

    def validate(self, batch: Batch) -> dict[str, Tensor]:
        """L_BC and its parts with the posterior's mean as z; each (B,)."""
        seen = self.inputs(batch.observation)
        mean, log_variance = self.posterior(seen, batch)
        decoded = self.decode(mean, self.tokens(seen, batch.observation.task))
        l_act, l_kl = self.terms(decoded, mean, log_variance, batch)
        return {"validation_loss": self.l_bc(l_act, l_kl), "validation_l_act": l_act, "validation_l_kl": l_kl}

    def terms(self, decoded: Tensor, mean: Tensor, log_variance: Tensor, batch: Batch) -> tuple[Tensor, Tensor]:
        """L_act and L_kl of each window, each (B,). decoded (B, k, A); mean and log variance of z (B, L)."""
        return l1_error(decoded, batch, self.imitation.action_space), losses.kl(mean, log_variance)

    def l_bc(self, l_act: Tensor, l_kl: Tensor) -> Tensor:
        """L_BC (B,) of l_act and l_kl (B,). The factor A is there because l_act is a sum over A components."""
        return l_act + self.sizes.actions * self.settings.kl_weight * l_kl

    @torch.no_grad()
    def plan(self, observation: Observation) -> Tensor:
        """The chunk (B, k, A) of z = 0, the mean of the prior."""
        tokens = self.tokens(self.inputs(observation), observation.task)
        return self.decode(tokens.new_zeros(tokens.shape[0], self.settings.latent), tokens)

    def policy(self, acting: ActingConfig) -> ChunkPolicy:
        """A policy that acts from the student's chunks."""
        return ChunkPolicy(self, acting)
