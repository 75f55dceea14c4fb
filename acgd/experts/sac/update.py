"""One update of soft actor-critic, arranged for a CPU core.

Both critics are one batched product per layer; the policy's gradient does not visit the critics' weights; the weights
of a network lie in one vector, so that Adam, the target's average and every change of precision are one call each; the
networks run in bfloat16 where the settings say so and the hardware can, on copies of weights that stay in float32, as
do moments, densities and returns.
"""

import copy
import math

import torch
from torch import Tensor
from torch.nn import functional as F
from torch.nn.utils import parameters_to_vector, vector_to_parameters

from acgd.experts.policy import LOG_STD, Expert
from acgd.experts.sac.settings import SACSettings
from acgd.nn.q_ensemble import Critic
from acgd.store import checkpoint
from acgd.store.precision import in_bfloat16

FIRST_STD = 0.5
"""Of the first policy."""
FIRST_Q = 0.1
"""Scale of the critics' last layer at first: at 1 their noise leads the policy astray before they have learned
anything."""

LOG_UNIT = 0.5 * math.log(2 * math.pi) + 2 * math.log(2)
"""What every dimension adds to the log density of an action: the Gaussian's norm, and the 4 of tanh'."""


class SACUpdate:
    """Policy, twin critics, their targets, temperature, and their optimisers.

    Rewards come in units of `reward_scale`, the running standard deviation of discounted returns: the critics regress
    Q / reward_scale, and `Critic.scale` brings them back into reward units.
    """

    def __init__(
        self,
        state_dim: int,
        action_dim: int,
        sac: SACSettings,
        generator: torch.Generator,
        device: torch.device = torch.device("cpu"),
    ) -> None:
        """Networks live on `device`, `generator` on the processor: weights and noise are the same on every device."""
        self.sac, self.generator, self.device = sac, generator, device
        self.actor = Expert(state_dim, action_dim, sac.width, squashed=True).requires_grad_(True)
        _initialise(self.actor, generator)
        self.critic = Critic(state_dim, action_dim, 2, sac.width, 2, sac.action_space, generator=generator)
        with torch.no_grad():
            self.critic.weights[-1].mul_(FIRST_Q)
        self.target = Critic(state_dim, action_dim, 2, sac.width, 2, sac.action_space)
        self.target.load_state_dict(self.critic.state_dict())
        self.target.requires_grad_(False)
        self.log_temperature = torch.nn.Parameter(torch.tensor(math.log(sac.temperature), device=device))
        masters = {"actor": self.actor.to(device), "critic": self.critic.to(device), "target": self.target.to(device)}
        self._networks = masters
        self._half = in_bfloat16(sac.precision, device)
        if self._half:
            self._networks = {name: copy.deepcopy(network).to(torch.bfloat16) for name, network in masters.items()}
        self._weights = {name: _joined(network) for name, network in masters.items()}
        self._used = (
            {name: _joined(network) for name, network in self._networks.items()}
            if self._networks is not masters
            else {}
        )
        learned = {name: torch.nn.Parameter(self._weights[name]) for name in ("actor", "critic")}
        self._gradients = {name: _gradients(weights, masters[name]) for name, weights in learned.items()}
        self.optimisers = {
            "actor": torch.optim.Adam([learned["actor"], self.log_temperature], sac.learning_rate, fused=True),
            "critic": torch.optim.Adam([learned["critic"]], sac.learning_rate, fused=True),
        }
        self.step = 0

    def normalise(self, mean: Tensor, std: Tensor, reward_scale: float) -> None:
        """Takes over the running statistics of states (S,) and returns."""
        for network in (self.actor, self.critic, self.target):
            network.state_mean.copy_(mean)
            network.state_std.copy_(std)
        self.critic.scale.fill_(reward_scale)
        self.target.scale.fill_(reward_scale)

    def start_from(self, actor: Expert, critic: Critic) -> None:
        """Takes over the policy and the critics of another expert. Raises ValueError where their sizes differ from
        these."""
        for name, other, here in (("policy", actor, self.actor), ("critics", critic, self.critic)):
            theirs, ours = (
                {key: tuple(value.shape) for key, value in network.state_dict().items()} for network in (other, here)
            )
            if theirs != ours or (name == "critics" and other.shape != here.shape):
                raise ValueError(
                    f"the {name} of expert.warm_start have other sizes: choose an expert of the same kind of task, "
                    "and its width and action_space"
                )
        self.actor.load_state_dict(actor.state_dict())
        for network in (self.critic, self.target):
            network.load_state_dict(critic.state_dict())
        for name in self._networks:
            self._copy(name)

    def learning_rate(self, rate: float) -> None:
        """For the updates that follow."""
        for optimiser in self.optimisers.values():
            optimiser.param_groups[0]["lr"] = rate

    def update(self, batch: tuple[Tensor, Tensor, Tensor, Tensor, Tensor]) -> None:
        """One step of the critics and their targets; every `actor_every` also one of policy and temperature."""
        state, action, reward, next_state, discount = (value.to(self.device) for value in batch)
        state, next_state = self.critic.normalise(state), self.critic.normalise(next_state)
        temperature = self.log_temperature.detach().exp()
        critic, target = self._networks["critic"], self._networks["target"]
        if self._half:
            state, next_state, action = (value.bfloat16() for value in (state, next_state, action))
        with torch.no_grad():
            next_action, log_prob = self.sample(next_state)
            value = target.network(next_state, next_action).amin(0) - temperature * log_prob
            y = reward / self.critic.scale + discount * value
        self._descend("critic", F.mse_loss(critic.network(state, action), y.expand(2, -1)))
        with torch.no_grad():  # here, while the critics' weights are in the cache
            self._weights["target"].lerp_(self._weights["critic"], self.sac.tau)
        self._copy("target")
        if self.step % self.sac.actor_every == 0:
            new_action, log_prob = self.sample(state)
            self.log_temperature.grad = -log_prob.detach().mean() - self.sac.target_entropy * action.shape[1]
            self._descend("actor", (temperature * log_prob - critic.network(state, new_action).amin(0)).mean())
        self.step += 1

    def sample(self, normal_state: Tensor) -> tuple[Tensor, Tensor]:
        """Action (B, A) of the policy and its log density (B,), for normalised states (B, S) in the precision of the
        networks."""
        mean, log_std = (value.float() for value in self._networks["actor"].network(normal_state))
        noise = torch.randn(mean.shape, generator=self.generator).to(self.device)
        before = torch.addcmul(mean, log_std.exp(), noise)
        # -log of the Gaussian's density and of the box's, tanh'(x) = 4 / (exp(x) + exp(-x))^2, without cancellation
        surprise = torch.addcmul(log_std, noise, noise, value=0.5) - 2 * (before + F.softplus(-2 * before))
        return torch.tanh(before).to(normal_state.dtype), -surprise.sum(-1) - mean.shape[-1] * LOG_UNIT

    def _descend(self, name: str, loss: Tensor) -> None:
        gradients = torch.autograd.grad(loss, list(self._networks[name].parameters()))
        for place, gradient in zip(self._gradients[name], gradients):
            place.copy_(gradient)
        self.optimisers[name].step()
        self._copy(name)

    def _copy(self, name: str) -> None:
        """Bring the weights of a network into the copy that runs in bfloat16."""
        if self._used:
            self._used[name].copy_(self._weights[name])

    # -- checkpoint --------------------------------------------------------------------------------

    def tensors(self) -> dict[str, Tensor]:
        """Everything that the next updates depend on, besides the generator."""
        tensors = {"log_temperature": self.log_temperature.detach()}
        for name, network in (("actor", self.actor), ("critic", self.critic), ("target", self.target)):
            tensors |= {f"{name}.{key}": value.clone() for key, value in network.state_dict().items()}
        for name, optimiser in self.optimisers.items():
            tensors |= checkpoint.moments_of(optimiser, f"adam.{name}.")
        return tensors

    def load(self, tensors: dict[str, Tensor], step: int) -> None:
        """The inverse of `tensors`, after `step` updates."""
        self.step = step
        with torch.no_grad():
            self.log_temperature.copy_(tensors["log_temperature"])
        for name, network in (("actor", self.actor), ("critic", self.critic), ("target", self.target)):
            network.load_state_dict(checkpoint.under(tensors, f"{name}."))
        for name, optimiser in self.optimisers.items():
            checkpoint.restore_moments(optimiser, tensors, f"adam.{name}.")
        for name in self._networks:
            self._copy(name)


@torch.no_grad()
def _joined(network: torch.nn.Module) -> Tensor:
    """The parameters of `network` as one vector (P,), of which they are views from now on."""
    weights = parameters_to_vector(network.parameters())
    vector_to_parameters(weights, network.parameters())
    return weights


def _gradients(weights: Tensor, network: torch.nn.Module) -> list[Tensor]:
    """`weights.grad` (P,) seen in the shapes of the parameters of `network`, so that each gradient is converted to its
    place."""
    weights.grad = torch.zeros_like(weights)
    shapes = [parameter.shape for parameter in network.parameters()]
    return [part.view(shape) for part, shape in zip(weights.grad.split([shape.numel() for shape in shapes]), shapes)]


def _initialise(actor: Expert, generator: torch.Generator) -> None:
    """Uniform by fan-in, as torch does; the first actions small, the first spread FIRST_STD."""
    with torch.no_grad():
        for layer in (actor.hidden1, actor.hidden2, actor.action, actor.spread):
            bound = layer.in_features**-0.5
            layer.weight.uniform_(-bound, bound, generator=generator)
            layer.bias.zero_()
        low, high = LOG_STD
        share = (math.log(FIRST_STD) - low) / (high - low)
        actor.spread.weight.mul_(0.1)
        actor.spread.bias.fill_(math.log(share / (1 - share)))
