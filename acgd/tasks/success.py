"""Three rules of success in the literature."""

from dataclasses import dataclass

HELD_STEPS = 5
"""`held` needs more solved steps than this number, as in MyoSuite."""


@dataclass
class SuccessCounter:
    """Counts the solved steps of one episode. `final` is the headline, as in the paper."""

    solved_steps: int = 0
    last: bool = False

    def update(self, solved: bool) -> None:
        """Counts one step."""
        self.solved_steps += int(solved)
        self.last = bool(solved)

    def outcome(self) -> dict[str, bool]:
        """Rule -> success so far. final: last step; held: more than HELD_STEPS steps; once: any step."""
        return {"final": self.last, "held": self.solved_steps > HELD_STEPS, "once": self.solved_steps > 0}
