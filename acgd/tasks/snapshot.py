"""A moment of an episode, to come back to."""

from dataclasses import dataclass

import mujoco
import numpy as np

STATE = mujoco.mjtState.mjSTATE_INTEGRATION
"""Positions, velocities, controls, user data and the solver's warm start: all that MuJoCo continues from."""


@dataclass(frozen=True)
class Snapshot:
    """Everything that the continuation of an episode depends on."""

    integration: np.ndarray
    """(N,) float64, mjSTATE_INTEGRATION."""
    model_fields: dict[str, np.ndarray]
    """Fields of mjModel written at reset; `target_angles` (23,) for pose tasks. Empty where a reset leaves the model alone."""
    steps: int = 0
    solved_steps: int = 0
    solved: bool = False
