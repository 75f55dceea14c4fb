"""Gymnasium names of the tasks: `gymnasium.make("acgd/myo-key-turn-v0")`.

`import acgd.tasks` has them registered; `gymnasium.make("acgd.tasks.gymnasium_ids:acgd/myo-key-turn-v0")` needs no
import of its own.
"""

import gymnasium

from acgd.tasks.spec import TASKS


def register() -> None:
    """Register every task, unless that has been done."""
    for spec in TASKS.values():
        if (name := f"acgd/{spec.slug}-v0") not in gymnasium.registry:
            gymnasium.register(
                id=name,
                entry_point="acgd.tasks.registry:make",
                kwargs={"task": spec.name},
                disable_env_checker=True,
            )


register()
