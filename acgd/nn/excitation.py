"""Muscle excitation u = 1 / (1 + exp(-5 (a - 0.5))), which MyoSuite computes from an action a.

Half of the action range maps to u <= 0.076, where large differences between actions have almost no effect.
"""

from typing import Literal

from torch import Tensor

ActionSpace = Literal["raw", "excitation"]
"""raw: actions. excitation: a function of the muscle excitation u."""

LOWEST = 1 / (1 + 2.718281828459045**7.5)
HIGHEST = 1 / (1 + 2.718281828459045**-2.5)
"""Excitations of the actions -1 and 1."""


def stretched_excitation(action: Tensor) -> Tensor:
    """u, scaled linearly so that [-1, 1] maps onto [-1, 1]. Any shape."""
    u = (5 * (action - 0.5)).sigmoid()
    return 2 * (u - LOWEST) / (HIGHEST - LOWEST) - 1


def to_loss_space(action: Tensor, space: ActionSpace) -> Tensor:
    """Actions in the space of students' encoders and losses: raw, or the stretched excitation. Any shape.

    It differs from `to_critic_input`: student losses are in units of the box [-1, 1].
    """
    return stretched_excitation(action) if space == "excitation" else action


def to_critic_input(action: Tensor, space: ActionSpace) -> Tensor:
    """Actions in the space of critics' inputs: raw, or 2 u - 1, which is 0.85 for the action 1. Any shape.

    It differs from `to_loss_space`: the published critics were trained with this formula.
    """
    return 2 * (5 * (action - 0.5)).sigmoid() - 1 if space == "excitation" else action
