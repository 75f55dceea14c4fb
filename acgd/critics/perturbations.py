"""Noise on the expert's action while transitions are gathered: a critic can judge only actions like executed ones."""

from collections.abc import Iterator

import numpy as np

from acgd.critics.settings import PerturbationConfig

Kind = tuple[str, float]
"""("clean" | "gaussian" | "bursts", standard deviation)"""


def kinds(config: PerturbationConfig) -> Iterator[Kind]:
    """The kind of each episode in turn, without random numbers: the kind whose count lies furthest below its share."""
    shares = {"clean": config.clean, "gaussian": config.gaussian, "bursts": config.bursts}
    counts = dict.fromkeys(shares, 0)
    while True:
        deficit = {name: share * (sum(counts.values()) + 1) - counts[name] for name, share in shares.items()}
        name = max(deficit, key=deficit.__getitem__)
        scale = {
            "clean": 0.0,
            "gaussian": config.scales[counts["gaussian"] % len(config.scales)],
            "bursts": config.burst_scale,
        }[name]
        counts[name] += 1
        yield name, scale


def offsets(
    kind: Kind, steps: int, action_dim: int, config: PerturbationConfig, rng: np.random.Generator
) -> np.ndarray:
    """Offsets (steps, A) float32 that are added to the expert's mean over one episode.

    A row of zeros follows the expert. The activation dynamics of muscles filter noise that changes at every step. An
    offset that is held for some steps passes, and leads to states from which the expert has to recover.
    """
    name, scale = kind
    noise = np.zeros((steps, action_dim), np.float32)
    if name == "gaussian":
        noise[:] = scale * rng.standard_normal((steps, action_dim))
    elif name == "bursts":
        start = int(rng.integers(config.burst_every))
        while start < steps:
            noise[start : start + config.burst_steps] = scale * rng.standard_normal(action_dim)
            start += config.burst_steps + 1 + int(rng.geometric(1 / config.burst_every))
    return noise
