"""How to make a task."""

from acgd.settings import imported
from acgd.tasks.settings import TaskConfig
from acgd.tasks.spec import TASKS


def make(task: TaskConfig | str, *, image_size: int | None = 84, reward_weights: dict[str, float] | None = None):
    """The Gymnasium environment of a task.

    `image_size` is the height and width of the observation's image in pixels. With None nothing is drawn and the
    observation holds no image; `render` draws in either case. `reward_weights` replaces the named weights of the task's
    reward; the others stay.
    """
    config = TaskConfig(name=task) if isinstance(task, str) else task
    spec = TASKS[config.name]
    return imported(spec.environment)(spec, config, image_size=image_size, reward_weights=reward_weights)
