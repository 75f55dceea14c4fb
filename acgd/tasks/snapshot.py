"""Snapshots of an episode."""

from dataclasses import dataclass

import numpy as np

from acgd.tasks.simulator import mujoco

STATE = mujoco.mjtState.mjSTATE_INTEGRATION
"""Positions, velocities, controls, user data and the solver's warm start: the state that MuJoCo integrates."""


@dataclass(frozen=True)
class Snapshot:
    """Everything that the continuation of an episode depends on."""

    integration: np.ndarray
    """(N,) float64, mjSTATE_INTEGRATION"""
    model_fields: dict[str, np.ndarray]
    """Fields of mjModel that a reset writes, and `target_angles` (23,) of pose tasks. Empty in the dexterous suites."""
    steps: int = 0
    solved_steps: int = 0
    solved: bool = False
