"""Noise on the expert's action while transitions are gathered: a critic knows only actions that have been executed."""

from collections.abc import Iterator

import numpy as np

from acgd.critics.settings import PerturbationConfig

Kind = tuple[str, float]
"""("clean" | "gaussian" | "bursts", standard deviation)"""


def kinds(config: PerturbationConfig) -> Iterator[Kind]:
    """The kind of each episode in turn, without chance: always the one that is furthest behind its share."""
    shares = {"clean": config.clean, "gaussian": config.gaussian, "bursts": config.bursts}
    given = dict.fromkeys(shares, 0)
    while True:
        due = {name: share * (sum(given.values()) + 1) - given[name] for name, share in shares.items()}
        name = max(due, key=due.__getitem__)
        scale = {
            "clean": 0.0,
            "gaussian": config.scales[given["gaussian"] % len(config.scales)],
            "bursts": config.burst_scale,
        }[name]
        given[name] += 1
        yield name, scale


def offsets(
    kind: Kind, steps: int, action_dim: int, config: PerturbationConfig, rng: np.random.Generator
) -> np.ndarray:
    """What is added to the expert's mean over an episode, (steps, A) float32; rows of zeros follow the expert.

    Noise that is fresh at every step is filtered by the muscles' activation dynamics; an offset held for some
    steps is not, and leads to states from which the expert has to recover.
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
