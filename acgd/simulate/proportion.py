"""A success rate and how well so many episodes determine it."""

from dataclasses import dataclass

from scipy.stats import binomtest


@dataclass(frozen=True)
class Proportion:
    """A success rate and its interval, as fractions."""

    rate: float
    low: float
    high: float


def wilson(successes: int, episodes: int, confidence: float = 0.95) -> Proportion:
    """Wilson's score interval. It stays inside [0, 1], and holds its level at no success and at successes only."""
    if not 0 <= successes <= episodes or episodes < 1:
        raise ValueError(
            f"{successes} successes of {episodes} episodes: need 0 <= successes <= episodes and at least one episode"
        )
    interval = binomtest(successes, episodes).proportion_ci(confidence, method="wilson")
    return Proportion(successes / episodes, float(interval.low), float(interval.high))
