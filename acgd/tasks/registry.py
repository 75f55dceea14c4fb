"""How to make a task."""

from collections.abc import Mapping

from acgd.settings import imported
from acgd.tasks.settings import TaskConfig
from acgd.tasks.spec import TASKS


def make(
    task: TaskConfig | Mapping[str, str] | str,
    *,
    image_size: int | None = 84,
    reward_weights: dict[str, float] | None = None,
):
    """The Gymnasium environment of a task, which is given by its name, or by its name and start.

    `image_size` is the height and width of the observation's image in pixels. With None nothing is drawn and the
    observation holds no image; `render` draws in either case. `reward_weights` replaces the named weights of the task's
    reward; the others stay.
    """
    config = TaskConfig(name=task) if isinstance(task, str) else TaskConfig.model_validate(task)
    spec = TASKS[config.name]
    return imported(spec.environment)(spec, config, image_size=image_size, reward_weights=reward_weights)
