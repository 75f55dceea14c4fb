"""Disjoint ranges of episode seeds, so that nothing is tuned on what it is judged by."""

from dataclasses import dataclass


@dataclass(frozen=True)
class SeedRange:
    """Half-open range of episode seeds with one purpose."""

    purpose: str
    start: int
    stop: int

    def take(self, n: int, offset: int = 0) -> list[int]:
        """`n` seeds from `offset` on. Raises ValueError when the range has no more."""
        first = self.start + offset
        if n < 0 or offset < 0 or first + n > self.stop:
            raise ValueError(
                f"{n} {self.purpose} seeds from offset {offset} asked, the range has {self.stop - self.start}: ask for fewer"
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


SEEDS = Seeds()
