"""One update of soft actor-critic (Haarnoja et al. 2018), arranged for one CPU core.

- Both critics are one batched product per layer.
- The policy's gradient leaves out the critics' weights.
- The weights of a network lie in one vector. Adam, the target's average and a change of precision are one call each.
- With precision bfloat16 the networks run on bfloat16 copies, where the hardware supports it. Weights, moments,
  densities and returns stay in float32.
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
"""Standard deviation of the initial policy."""
FIRST_Q = 0.1
"""Initial scale of the critics' last layer. With 1, the noise of untrained critics misleads the policy."""

LOG_UNIT = 0.5 * math.log(2 * math.pi) + 2 * math.log(2)
"""Constant of the log density per action dimension: docs/method.md, "Density of a squashed action"."""


class SACUpdate:
    """Policy, twin critics, their targets, temperature, and their optimisers.

    The critics regress Q / reward_scale. `reward_scale` is the running standard deviation of discounted returns, and
    `Critic.scale` maps the output back to reward units.
    """

    def __init__(
        self,
        state_dim: int,
        action_dim: int,
        sac: SACSettings,
        generator: torch.Generator,
        device: torch.device = torch.device("cpu"),
    ) -> None:
        """device: of the networks. generator: on the CPU, so that weights and noise do not depend on the device."""
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
        float32_networks = {
            "actor": self.actor.to(device),
            "critic": self.critic.to(device),
            "target": self.target.to(device),
        }
        self._networks = float32_networks
        self._bfloat16 = in_bfloat16(sac.precision, device)
        if self._bfloat16:
            self._networks = {
                name: copy.deepcopy(network).to(torch.bfloat16) for name, network in float32_networks.items()
            }
        self._weights = {name: _flat_parameters(network) for name, network in float32_networks.items()}
        self._copies = (
            {name: _flat_parameters(network) for name, network in self._networks.items()}
            if self._networks is not float32_networks
            else {}
        )
        parameters = {name: torch.nn.Parameter(self._weights[name]) for name in ("actor", "critic")}
        self._gradients = {name: _gradients(weights, float32_networks[name]) for name, weights in parameters.items()}
        self.optimisers = {
            "actor": torch.optim.Adam([parameters["actor"], self.log_temperature], sac.learning_rate, fused=True),
            "critic": torch.optim.Adam([parameters["critic"]], sac.learning_rate, fused=True),
        }
        self.step = 0

    def normalise(self, mean: Tensor, std: Tensor, reward_scale: float) -> None:
        """Sets the normalisers: mean and standard deviation of states (S,), and the standard deviation of returns."""
        for network in (self.actor, self.critic, self.target):
            network.state_mean.copy_(mean)
            network.state_std.copy_(std)
        self.critic.scale.fill_(reward_scale)
        self.target.scale.fill_(reward_scale)

    def start_from(self, actor: Expert, critic: Critic) -> None:
        """Copies the policy and the critics of another expert. ValueError where the sizes differ."""
        for name, source, destination in (("policy", actor, self.actor), ("critics", critic, self.critic)):
            source_shapes, shapes = (
                {key: tuple(value.shape) for key, value in network.state_dict().items()}
                for network in (source, destination)
            )
            if source_shapes != shapes or (name == "critics" and source.shape != destination.shape):
                raise ValueError(
                    f"the {name} of expert.warm_start have other sizes: choose an expert of the same kind of task, "
                    "and its width and action_space"
                )
        self.actor.load_state_dict(actor.state_dict())
        for network in (self.critic, self.target):
            network.load_state_dict(critic.state_dict())
        for name in self._networks:
            self._update_copy(name)

    def learning_rate(self, rate: float) -> None:
        """Sets the step size of all optimisers."""
        for optimiser in self.optimisers.values():
            optimiser.param_groups[0]["lr"] = rate

    def update(self, batch: tuple[Tensor, Tensor, Tensor, Tensor, Tensor]) -> None:
        """One step of critics and targets; in every `actor_every`-th update also one of policy and temperature.

        batch: s (B, S), a (B, A), r (B,), s' (B, S), discount (B,), as from `Replay.sample`.
        """
        state, action, reward, next_state, discount = (value.to(self.device) for value in batch)
        state, next_state = self.critic.normalise(state), self.critic.normalise(next_state)
        temperature = self.log_temperature.detach().exp()
        critic, target = self._networks["critic"], self._networks["target"]
        if self._bfloat16:
            state, next_state, action = (value.bfloat16() for value in (state, next_state, action))
        with torch.no_grad():
            next_action, log_prob = self.sample(next_state)
            value = target.network(next_state, next_action).amin(0) - temperature * log_prob
            y = reward / self.critic.scale + discount * value
        self._gradient_step("critic", F.mse_loss(critic.network(state, action), y.expand(2, -1)))
        with torch.no_grad():  # at this place the critics' weights are in the cache
            self._weights["target"].lerp_(self._weights["critic"], self.sac.tau)
        self._update_copy("target")
        if self.step % self.sac.actor_every == 0:
            new_action, log_prob = self.sample(state)
            self.log_temperature.grad = -log_prob.detach().mean() - self.sac.target_entropy * action.shape[1]
            self._gradient_step("actor", (temperature * log_prob - critic.network(state, new_action).amin(0)).mean())
        self.step += 1

    def sample(self, normal_state: Tensor) -> tuple[Tensor, Tensor]:
        """Normalised states (B, S) in the networks' precision -> sampled action (B, A) and its log density (B,)."""
        mean, log_std = (value.float() for value in self._networks["actor"].network(normal_state))
        noise = torch.randn(mean.shape, generator=self.generator).to(self.device)
        pre_tanh = torch.addcmul(mean, log_std.exp(), noise)
        # docs/method.md, "Density of a squashed action": softplus avoids cancellation
        negative_log_density = torch.addcmul(log_std, noise, noise, value=0.5) - 2 * (
            pre_tanh + F.softplus(-2 * pre_tanh)
        )
        return torch.tanh(pre_tanh).to(normal_state.dtype), -negative_log_density.sum(-1) - mean.shape[-1] * LOG_UNIT

    def _gradient_step(self, name: str, loss: Tensor) -> None:
        gradients = torch.autograd.grad(loss, list(self._networks[name].parameters()))
        for view, gradient in zip(self._gradients[name], gradients):
            view.copy_(gradient)
        self.optimisers[name].step()
        self._update_copy(name)

    def _update_copy(self, name: str) -> None:
        """Copies the float32 weights of a network into its bfloat16 copy, if there is one."""
        if self._copies:
            self._copies[name].copy_(self._weights[name])

    # -- checkpoint --------------------------------------------------------------------------------

    def tensors(self) -> dict[str, Tensor]:
        """Everything that the next updates depend on, except the generator."""
        tensors = {"log_temperature": self.log_temperature.detach()}
        for name, network in (("actor", self.actor), ("critic", self.critic), ("target", self.target)):
            tensors |= {f"{name}.{key}": value.clone() for key, value in network.state_dict().items()}
        for name, optimiser in self.optimisers.items():
            tensors |= checkpoint.moments_of(optimiser, f"adam.{name}.")
        return tensors

    def load(self, tensors: dict[str, Tensor], step: int) -> None:
        """Restores the state that `tensors` returned after `step` updates."""
        self.step = step
        with torch.no_grad():
            self.log_temperature.copy_(tensors["log_temperature"])
        for name, network in (("actor", self.actor), ("critic", self.critic), ("target", self.target)):
            network.load_state_dict(checkpoint.under(tensors, f"{name}."))
        for name, optimiser in self.optimisers.items():
            checkpoint.restore_moments(optimiser, tensors, f"adam.{name}.")
        for name in self._networks:
            self._update_copy(name)


@torch.no_grad()
def _flat_parameters(network: torch.nn.Module) -> Tensor:
    """Moves the parameters of `network` into one vector (P,), and makes them views of it. Returns the vector."""
    weights = parameters_to_vector(network.parameters())
    vector_to_parameters(weights, network.parameters())
    return weights


def _gradients(weights: Tensor, network: torch.nn.Module) -> list[Tensor]:
    """Views of `weights.grad` (P,) in the shapes of the parameters of `network`."""
    weights.grad = torch.zeros_like(weights)
    shapes = [parameter.shape for parameter in network.parameters()]
    return [part.view(shape) for part, shape in zip(weights.grad.split([shape.numel() for shape in shapes]), shapes)]


def _initialise(actor: Expert, generator: torch.Generator) -> None:
    """Draws layers uniformly by fan-in. Initial actions are small, with standard deviation FIRST_STD."""
    with torch.no_grad():
        for layer in (actor.hidden1, actor.hidden2, actor.action, actor.spread):
            bound = layer.in_features**-0.5
            layer.weight.uniform_(-bound, bound, generator=generator)
            layer.bias.zero_()
        low, high = LOG_STD
        share = (math.log(FIRST_STD) - low) / (high - low)
        actor.spread.weight.mul_(0.1)
        actor.spread.bias.fill_(math.log(share / (1 - share)))
