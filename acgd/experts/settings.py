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
        """Policy, and the critics that were trained beside it, if any."""
        return zoo.policy_files(task)

    def faults(self, task: str) -> Iterator[str]:
        """A task that the zoo lacks."""
        if not zoo.has_expert(task):
            yield (
                f"expert.kind: zoo/ has no expert for {task}. "
                f"Train one (expert.kind: ppo), or take tasks that it has: {zoo.tasks_with(zoo.has_expert)}."
            )

    def has_critics(self, task: str) -> bool:
        """Whether the expert comes with critics that were trained beside its policy."""
        return zoo.has_learned_critics(task)


ExpertConfig = one_of(LEARNERS, default="zoo")


class ExpertRequest(Request):
    """What an expert depends on."""

    task: TaskConfig
    expert: ExpertConfig = Field(ZooSettings(), description="Stage `expert`, one artifact per task.")

    def files(self) -> tuple[Path, ...]:
        """What it is copied from, or what its training starts from."""
        return self.expert.files(self.task.name)


class CardConfig(Section):
    """How well an expert does, on seeds that its training has not seen."""

    episodes: int = Field(
        default=200,
        ge=1,
        description="Held-out episodes behind the success on the card. The card in zoo/ serves where it has as many.",
    )


class CardRequest(Request):
    """What an expert's card depends on, besides the expert."""

    task: TaskConfig
    expert: ExpertConfig = ZooSettings()
    card: CardConfig = Field(CardConfig(), description="Stage `card`, one artifact per task.")

    def files(self) -> tuple[Path, ...]:
        """Card and learning curve of an expert that was trained elsewhere."""
        return zoo.card_files(self.task.name) if isinstance(self.expert, ZooSettings) else ()
