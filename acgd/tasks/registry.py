"""Constructs the environment of a task."""

from collections.abc import Mapping

from acgd.settings import imported
from acgd.tasks.settings import TaskConfig
from acgd.tasks.spec import TASKS


def make(
    task: TaskConfig | Mapping[str, str] | str,
    *,
    image_size: int | None = 84,
    reward_weights: dict[str, float] | None = None,
    render_mode: str | None = "rgb_array",
):
    """The Gymnasium environment of a task, which is given by its name, or by its name and start.

    image_size: height and width of the observation's image in pixels; with None the observation has no image. `render`
    works in both cases. reward_weights: reward term -> weight, in place of the task's default.
    render_mode: `rgb_array` or None, for Gymnasium's makers; `render` draws in both cases.
    """
    config = TaskConfig(name=task) if isinstance(task, str) else TaskConfig.model_validate(task)
    spec = TASKS[config.name]
    return imported(spec.environment)(
        spec, config, image_size=image_size, reward_weights=reward_weights, render_mode=render_mode
    )
