"""Gymnasium ids of the tasks: `gymnasium.make("acgd.tasks.gymnasium_ids:acgd/myo-key-turn-v0")`.

The import of this module registers the ids.
"""

import gymnasium

from acgd.tasks.spec import TASKS

for _spec in TASKS.values():
    gymnasium.register(
        id=f"acgd/{_spec.slug}-v0",
        entry_point="acgd.tasks.registry:make",
        kwargs={"task": _spec.name},
        disable_env_checker=True,
    )
