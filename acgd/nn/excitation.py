"""Muscle excitation: what MyoSuite makes of an action before it reaches the muscles, u = 1 / (1 + exp(-5 (a - 0.5))).

Half of the action range maps to u <= 0.076: there, large differences between actions mean next to nothing.
"""

from typing import Literal

from torch import Tensor

ActionSpace = Literal["raw", "excitation"]
"""raw: actions as they are. excitation: what they mean to a muscle."""

LOWEST = 1 / (1 + 2.718281828459045**7.5)
HIGHEST = 1 / (1 + 2.718281828459045**-2.5)
"""Excitations of the actions -1 and 1."""


def stretched_excitation(action: Tensor) -> Tensor:
    """u, stretched so that the box [-1, 1] maps onto itself. Any shape."""
    u = (5 * (action - 0.5)).sigmoid()
    return 2 * (u - LOWEST) / (HIGHEST - LOWEST) - 1


def to_loss_space(action: Tensor, space: ActionSpace) -> Tensor:
    """Actions as students encode and compare them: raw, or the stretched excitation. Any shape.

    Not `to_critic_input`: the losses of students are in units of the whole box, which the stretched excitation keeps.
    """
    return stretched_excitation(action) if space == "excitation" else action


def to_critic_input(action: Tensor, space: ActionSpace) -> Tensor:
    """Actions in [-1, 1] as a critic reads them: raw, or 2 u - 1, which ends at 0.85 for the action 1. Any shape.

    Not `to_loss_space`: the published critics have learned their weights on this formula.
    """
    return 2 * (5 * (action - 0.5)).sigmoid() - 1 if space == "excitation" else action
