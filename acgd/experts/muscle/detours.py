"""Detours of pose tasks: postures that muscle control strives for on its way, found by CMA-ES on training seeds
(detour_search.py).

Muscles cannot bend a finger's last joint for itself, nor the thumb's three joints: from an open hand the straight way
to a pose ends beside it, at 0.9 rad where 0.7 count. Started at the pose, the same controller stays within 0.3 rad.
What leads there is a detour: joint limits take the fingers past what muscles cannot. Angles beyond a joint's range say
how hard it pushes against its limit.
"""

from dataclasses import dataclass

import numpy as np

from acgd.tasks.myodex import HAND_JOINTS

WRIST = 3
"""Joints before the first finger's in HAND_JOINTS: the wrist's."""
CLENCHED = [i for i, name in enumerate(HAND_JOINTS) if i == WRIST or (i > WRIST and "abduction" not in name)]
"""Joints that a detour moves: the thumb's four, and flexions of the other fingers (mcp, pm, md of each)."""


@dataclass(frozen=True)
class Detour:
    """What a pose episode starts with."""

    steps: int
    """Control steps."""
    gain: float
    """Of the rate, beside that of the rest of the episode."""
    posture: np.ndarray
    """Angles (16,) of CLENCHED, rad."""
    share: np.ndarray
    """Of the goal's angles (16,), added to `posture`."""


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
