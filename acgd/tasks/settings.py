"""Settings of a task and of its images."""

import difflib
from typing import Literal

from pydantic import Field, field_validator

from acgd.settings import Section
from acgd.tasks.spec import TASKS


class TaskConfig(Section):
    """One task of a study: the settings that change an episode."""

    name: str = Field(description="Name of a task, such as myo/key-turn or myo/reach-hard.")
    start: Literal["perturbed", "nominal"] = Field(
        default="perturbed",
        description="perturbed: robot, object and goal drawn by seed (docs/tasks.md); nominal: the suite's own reset.",
    )

    @field_validator("name")
    @classmethod
    def _known(cls, name: str) -> str:
        if name not in TASKS:
            near = difflib.get_close_matches(name, TASKS, n=1, cutoff=0.0)
            raise ValueError(f"unknown task {name!r}; nearest is {near[0]!r}. Tasks: {', '.join(TASKS)}")
        return name


class ImageConfig(Section):
    """The image of an observation. Experts and critics use no images."""

    size: int = Field(84, ge=32, le=512, description="Height and width of the image in pixels.")
