"""Single-task experts and their cards."""

from collections.abc import Iterator
from pathlib import Path
from typing import Literal

from pydantic import Field

from acgd.experts import zoo
from acgd.experts.kinds import LEARNERS
from acgd.settings import Request, Section, one_of
from acgd.tasks.settings import TaskConfig


class ZooSettings(Section):
    """The trained expert in zoo/."""

    kind: Literal["zoo"] = "zoo"

    def files(self, task: str) -> tuple[Path, ...]:
        """The policy, and the critics that were trained with it, if any."""
        return zoo.policy_files(task)

    def faults(self, task: str) -> Iterator[str]:
        """A message where the zoo has no expert for the task."""
        if not zoo.has_expert(task):
            yield (
                f"expert.kind: zoo/ has no expert for {task}. "
                f"Train one (expert.kind: ppo), or take tasks that it has: {zoo.tasks_with(zoo.has_expert)}."
            )

    def has_critics(self, task: str) -> bool:
        """Whether the expert has critics that were trained with its policy."""
        return zoo.has_learned_critics(task)


ExpertConfig = one_of(LEARNERS, default="zoo")


class ExpertRequest(Request):
    """Request of the stage `expert`."""

    task: TaskConfig
    expert: ExpertConfig = Field(ZooSettings(), description="Stage `expert`, one artifact per task.")

    def files(self) -> tuple[Path, ...]:
        """Files of the zoo that the expert is copied from, or that its training starts from."""
        return self.expert.files(self.task.name)


class CardConfig(Section):
    """The measurement of an expert on held-out seeds."""

    episodes: int = Field(
        default=200,
        ge=1,
        description="Held-out episodes of the card. The card in zoo/ is used where it has at least as many.",
    )


class CardRequest(Request):
    """Request of the stage `card`."""

    task: TaskConfig
    expert: ExpertConfig = ZooSettings()
    card: CardConfig = Field(CardConfig(), description="Stage `card`, one artifact per task.")

    def files(self) -> tuple[Path, ...]:
        """Card and learning curve in the zoo, for an expert of the zoo."""
        return zoo.card_files(self.task.name) if isinstance(self.expert, ZooSettings) else ()
