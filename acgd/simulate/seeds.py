"""Disjoint ranges of episode seeds. Tuning and evaluation never share a seed."""

from dataclasses import dataclass


@dataclass(frozen=True)
class SeedRange:
    """Half-open range of episode seeds for one purpose."""

    purpose: str
    start: int
    stop: int

    def take(self, n: int, offset: int = 0) -> list[int]:
        """`n` seeds from `offset` on. ValueError where they exceed the range."""
        first = self.start + offset
        if n < 0 or offset < 0 or first + n > self.stop:
            raise ValueError(
                f"{n} {self.purpose} seeds from offset {offset} exceed its {self.stop - self.start}: take fewer"
            )
        return list(range(first, first + n))


@dataclass(frozen=True)
class Seeds:
    """One range per purpose."""

    expert_training: SeedRange = SeedRange("expert-training", 0, 10_000_000)
    demonstrations: SeedRange = SeedRange("demonstration", 10_000_000, 20_000_000)
    critic_fit: SeedRange = SeedRange("critic-fit", 20_000_000, 30_000_000)
    critic_quality: SeedRange = SeedRange("critic-quality", 30_000_000, 40_000_000)
    validation: SeedRange = SeedRange("validation", 40_000_000, 50_000_000)
    expert_card: SeedRange = SeedRange("expert-card", 50_000_000, 60_000_000)
    evaluation: SeedRange = SeedRange("evaluation", 60_000_000, 70_000_000)
    on_policy: SeedRange = SeedRange("on-policy", 70_000_000, 80_000_000)


SEEDS = Seeds()

ROUNDS = 100
"""Largest number of on-policy rounds of a student."""
ROUND_EPISODES = 10_000
"""Largest number of episodes per task in one round."""
_BLOCK, _STUDENTS = 100_000, 90
"""Seeds per round, and number of first seeds in a round that students are distributed over."""


def round_seeds(student: int, round: int, episodes: int) -> list[int]:
    """`episodes` on-policy seeds of round 1, 2, ... of the student with training seed `student`.

    Two rounds of one student share no seed. Two students may share seeds. ValueError beyond ROUNDS or ROUND_EPISODES.
    """
    if not (1 <= round <= ROUNDS and episodes <= ROUND_EPISODES):
        raise ValueError(
            f"round {round} of {episodes} episodes: there are {ROUNDS} rounds of {ROUND_EPISODES} episodes"
        )
    first = (round - 1) * _BLOCK + (student % _STUDENTS) * ((_BLOCK - ROUND_EPISODES) // _STUDENTS)
    return SEEDS.on_policy.take(episodes, offset=first)
