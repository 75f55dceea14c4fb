"""Minari's datasets: `acgd/<task>/<name>-v<version>/data/` with main_data.hdf5 and metadata.json.

`gymnasium.make` resolves the environment's specification in the metadata where this package is installed. The group
`acgd` of an episode holds the simulator's state before the first action and the fields of the model that the reset
wrote. From both an episode is replayed in the simulator. Minari ignores the group.
"""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import gymnasium
import h5py
import numpy as np
from gymnasium.envs.registration import EnvSpec

from acgd.export.hdf5 import put
from acgd.export.minari.settings import MinariSettings
from acgd.export.recording import Recording, Recordings, load_all
from acgd.tasks import registry
from acgd.tasks.spec import TASKS

MINARI = "0.5.4"
"""Version of the layout, the first with raw images."""
OBSERVATIONS = ("image", "proprio", "state")


def write(settings: MinariSettings, artifacts: Sequence[Path], folder: Path) -> str:
    """Writes one dataset for each task."""
    names = []
    for task in load_all(artifacts):
        names.append(f"acgd/{TASKS[task.task.name].slug}/{settings.name}-v{settings.version}")
        data = folder / names[-1] / "data"
        data.mkdir(parents=True)
        with h5py.File(data / "main_data.hdf5", "w", track_order=True) as file:
            for number, episode in enumerate(task):
                _write_episode(file.create_group(f"episode_{number}"), number, episode)
        metadata = _metadata(task, names[-1], (data / "main_data.hdf5").stat().st_size)
        (data / "metadata.json").write_text(json.dumps(metadata) + "\n", encoding="utf-8")
    return USE.format(name=names[0])


def _write_episode(group: h5py.Group, number: int, episode: Recording) -> None:
    steps, last = episode.steps, np.arange(episode.length) == episode.length - 1
    terminated = episode.outcome["terminated"]
    for name in OBSERVATIONS:
        put(group.require_group("observations"), name, episode.whole(name))
    put(group, "actions", steps["action"])
    put(group, "rewards", steps["reward"].astype(np.float64))
    put(group, "terminations", last & terminated)
    put(group, "truncations", last & (not terminated))
    put(group.create_group("infos"), "solved", np.concatenate([[False], steps["solved"]]))
    extra = group.create_group("acgd")
    put(extra, "integration", steps["integration"][0])
    for name, value in episode.model_fields.items():
        put(extra.require_group("model_fields"), name, value)
    extra.require_group("model_fields")
    for name in ("mean_action", "by_expert"):
        if name in steps:
            put(extra, name, steps[name])
    extra.attrs["outcome"] = json.dumps(episode.outcome)
    group.attrs.update({"id": number, "seed": episode.seed, "total_steps": episode.length})


def _metadata(task: Recordings, name: str, size: int) -> dict[str, Any]:
    kwargs = {"task": task.task.model_dump(), "image_size": task.image_size}
    specification = EnvSpec(
        id=f"acgd/{TASKS[task.task.name].slug}-v0",
        entry_point="acgd.tasks.registry:make",
        kwargs=kwargs,
        disable_env_checker=True,
    )
    env = registry.make(**kwargs)
    return {
        "total_episodes": len(task),
        "total_steps": int(task.demonstrations.lengths.sum()),
        "data_format": "hdf5",
        "jpeg_encoding": False,
        "observation_space": json.dumps(_space(env.observation_space)),
        "action_space": json.dumps(_space(env.action_space)),
        "env_spec": specification.to_json(),
        "dataset_id": name,
        "dataset_size": round(size / 1e6, 1),
        "minari_version": MINARI,
        "algorithm_name": task.manifest["stage"],
        "requirements": ["acgd-in-a-box"],
    }


def _space(space: gymnasium.Space) -> dict[str, Any]:
    """A box, or a dictionary of boxes, in the form of Minari."""
    if isinstance(space, gymnasium.spaces.Dict):
        return {"type": "Dict", "subspaces": {name: _space(part) for name, part in space.spaces.items()}}
    bounds = {"low": space.low.tolist(), "high": space.high.tolist()}
    return {"type": "Box", "dtype": str(space.dtype), "shape": list(space.shape), **bounds}


USE = """\
Datasets of Minari. Images are raw, which Minari reads from version 0.5.4 on. Observations hold `image`, `proprio` and
the privileged `state`, which a policy that acts from images must not read.

```python
import os

os.environ["MINARI_DATASETS_PATH"] = "<this folder>"
import minari

dataset = minari.load_dataset("{name}")
env = dataset.recover_environment()    # where this package is installed
```

Replay the episodes in the simulator: `python -m acgd replay <this folder>`.
"""
