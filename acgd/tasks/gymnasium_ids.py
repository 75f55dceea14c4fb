"""Gymnasium names of the tasks: `gymnasium.make("acgd/myo-key-turn-v0")`.

An installed package registers them when Gymnasium is imported (pyproject.toml). In a clone that is not installed,
importing this module does: `gymnasium.make("acgd.tasks.gymnasium_ids:acgd/myo-key-turn-v0")`.
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
