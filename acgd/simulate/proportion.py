"""A success rate over episodes with its confidence interval."""

from typing import NamedTuple

from scipy.stats import binomtest


class Proportion(NamedTuple):
    """A rate and its confidence interval, as fractions."""

    rate: float
    low: float
    high: float


def wilson(successes: int, episodes: int, confidence: float = 0.95) -> Proportion:
    """Wilson score interval of a success rate. It lies in [0, 1], and its width is positive at rates of 0 and 1."""
    if episodes < 1 or not 0 <= successes <= episodes:
        raise ValueError(
            f"{successes} successes of {episodes} episodes: need 0 <= successes <= episodes and at least one episode"
        )
    interval = binomtest(int(successes), int(episodes)).proportion_ci(confidence, method="wilson")
    return Proportion(successes / episodes, float(interval.low), float(interval.high))
