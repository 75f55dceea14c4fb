"""Detours of pose tasks: postures that the muscle controller approaches before the goal.

detour_search.py finds them. Reasons: docs/method.md, "Detours of pose tasks".
"""

from dataclasses import dataclass

import numpy as np

from acgd.tasks.myodex import HAND_JOINTS

WRIST = 3
"""Number of wrist joints, which come first in HAND_JOINTS."""
CLENCHED = [i for i, name in enumerate(HAND_JOINTS) if i == WRIST or (i > WRIST and "abduction" not in name)]
"""Indices of the 16 joints that a detour moves: four of the thumb, and the flexions mcp, pm, md of each finger."""


@dataclass(frozen=True)
class Detour:
    """Target of the controller in the first steps of an episode: posture + share * goal angles."""

    steps: int
    """Length in control steps."""
    gain: float
    """Factor on the controller's rate during the detour."""
    posture: np.ndarray
    """Angles (16,) of CLENCHED, rad."""
    share: np.ndarray
    """Share (16,) of the goal's angles that is added to `posture`."""


DETOURS = {
    "myo/pose": Detour(
        steps=27,
        gain=2.9,
        posture=np.array(
            [-0.01, 0.48, -0.05, 0.38]  # thumb: cmc_abduction, cmc_flexion, mp_flexion, ip_flexion
            + [-0.39, -0.10, 0.65]  # index finger: mcp_flexion, pm_flexion, md_flexion
            + [3.87, 2.41, 2.07]  # middle
            + [-0.80, -0.57, 0.08]  # ring
            + [0.05, 2.02, 0.33]  # little
        ),
        share=np.zeros(16),
    ),
    "myo/pose-hard": Detour(
        steps=26,
        gain=2.9,
        posture=np.array(
            [0.39, 1.23, -0.16, 2.04]
            + [0.58, 1.46, 0.42]
            + [0.19, 0.95, 1.23]
            + [0.11, 0.59, 0.56]
            + [0.38, 0.47, 1.55]
        ),
        share=np.array(
            [1.69, 1.39, 0.78, 0.31] + [0.85, 2.34, 1.92] + [2.47, 2.43, 2.15] + [0.59, 1.79, 3.17] + [1.47, 1.58, 1.13]
        ),
    ),
}
