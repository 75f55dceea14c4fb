"""The three ways in which the literature counts success."""

from dataclasses import dataclass

HELD_STEPS = 5
"""`held` needs more solved steps than this, as MyoSuite counts."""


@dataclass
class SuccessCounter:
    """Follows one episode. `final` is the headline, as in the paper."""

    solved_steps: int = 0
    last: bool = False

    def update(self, solved: bool) -> None:
        """Count one more step."""
        self.solved_steps += int(solved)
        self.last = bool(solved)

    def outcome(self) -> dict[str, bool]:
        """Success so far; after the last step, the episode's."""
        return {"final": self.last, "held": self.solved_steps > HELD_STEPS, "once": self.solved_steps > 0}
