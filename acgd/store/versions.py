"""What code and which simulator an artifact was made by, as far as its meaning depends on them."""

from functools import cache
from importlib.metadata import version

STAGES: dict[str, int] = {
    "expert": 1,
    "critic": 2,
    "rollouts": 1,
    "backbone": 1,
    "features": 1,
    "codebook": 1,
    "student": 2,
    "evaluation": 1,
    "controls": 1,
    "report": 1,
}
"""Stage -> version of its meaning, in the order of the chain. Raise one when the same request would give another
artifact: everything made by the old code, and everything downstream of it, is then made anew."""

SIMULATOR = ("mujoco", "myosuite", "myo-sim")
"""Packages whose version changes what happens in an episode."""


@cache
def simulator() -> dict[str, str]:
    """Installed versions; reads metadata, imports nothing."""
    return {package: version(package) for package in SIMULATOR}
