"""How to make a task."""

from acgd.settings import imported
from acgd.tasks.settings import TaskConfig
from acgd.tasks.spec import TASKS


def make(task: TaskConfig | str, *, image: bool = True, reward_weights: dict[str, float] | None = None):
    """The Gymnasium environment of a task.

    Without `image` nothing is rendered and the observation holds no image. `reward_weights` replaces
    the named weights of the task's reward; the others stay.
    """
    config = TaskConfig(name=task) if isinstance(task, str) else task
    spec = TASKS[config.name]
    return imported(spec.environment)(spec, config, image=image, reward_weights=reward_weights)
