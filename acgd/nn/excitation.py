"""Muscle excitation: what MyoSuite makes of an action before it reaches the muscles."""

from typing import Literal

from torch import Tensor

LOWEST = 1 / (1 + 2.718281828459045**7.5)
HIGHEST = 1 / (1 + 2.718281828459045**-2.5)
"""Excitations of the actions -1 and 1."""


def excitation(action: Tensor) -> Tensor:
    """u = 1 / (1 + exp(-5 (a - 0.5))), stretched so that the box [-1, 1] maps onto itself.

    Half of the action range maps to u <= 0.076: there, large differences between actions mean next to nothing.
    """
    u = (5 * (action - 0.5)).sigmoid()
    return 2 * (u - LOWEST) / (HIGHEST - LOWEST) - 1


def in_action_space(action: Tensor, space: Literal["raw", "excitation"]) -> Tensor:
    """Actions in the space in which a student encodes and compares them."""
    return excitation(action) if space == "excitation" else action
