"""robomimic's HDF5: `data/demo_<i>` with `obs`, `next_obs`, `actions`, `states`, ...; masks `train` and `valid`.

`states` is MuJoCo's mjSTATE_INTEGRATION before each action. The group `model_fields` of a demonstration holds the
fields of the model that its reset wrote. From both a demonstration is replayed in the simulator. robomimic ignores the
group.
"""

import json
from collections.abc import Sequence
from pathlib import Path

import h5py
import numpy as np

from acgd.export.hdf5 import put
from acgd.export.recording import Recording, Recordings, load_all
from acgd.export.robomimic.settings import RobomimicSettings
from acgd.tasks.spec import TASKS

GYM_TYPE = 2
"""robomimic's number for environments of Gym."""
OBSERVATIONS = ("image", "proprio", "state")


def write(settings: RobomimicSettings, artifacts: Sequence[Path], folder: Path) -> str:
    """Writes `<task>.hdf5` for each task."""
    for task in load_all(artifacts):
        with h5py.File(folder / f"{TASKS[task.task.name].slug}.hdf5", "w", libver="latest") as file:
            _write_task(file, task)
    return USE


def _write_task(file: h5py.File, task: Recordings) -> None:
    data, total = file.create_group("data"), 0
    for number, episode in enumerate(task):
        _write_episode(data.create_group(f"demo_{number}"), episode)
        total += episode.length
    data.attrs["total"] = total
    kwargs = {"task": task.task.model_dump(), "image_size": task.image_size}
    environment = {"env_name": f"acgd/{TASKS[task.task.name].slug}-v0", "type": GYM_TYPE, "env_kwargs": kwargs}
    data.attrs["env_args"] = json.dumps(environment, indent=4)
    data.attrs["state_layout"] = json.dumps(task.names)
    training, validation = task.demonstrations.split()
    for name, episodes in (("train", training), ("valid", validation)):
        file[f"mask/{name}"] = np.array([f"demo_{e}" for e in episodes], dtype="S")


def _write_episode(demo: h5py.Group, episode: Recording) -> None:
    steps = episode.steps
    for name in OBSERVATIONS:
        whole = episode.whole(name)
        put(demo.require_group("obs"), name, whole[:-1])
        put(demo.require_group("next_obs"), name, whole[1:])
    put(demo, "actions", steps["action"])
    put(demo, "states", steps["integration"])
    put(demo, "rewards", steps["reward"])
    put(demo, "dones", (np.arange(episode.length) == episode.length - 1).astype(np.int64))
    put(demo, "solved", steps["solved"])
    for name in ("mean_action", "by_expert"):
        if name in steps:
            put(demo, name, steps[name])
    fields = demo.create_group("model_fields")
    for name, value in episode.model_fields.items():
        put(fields, name, value)
    demo.attrs["num_samples"] = episode.length
    demo.attrs["seed"] = episode.seed
    demo.attrs["outcome"] = json.dumps(episode.outcome)


USE = """\
One file of robomimic for each task, with the masks `train` and `valid`: this project's split of the episodes.
Observations: `image` (rgb), `proprio` (low_dim), and the privileged `state` (low_dim), which a policy that acts from
images must not read.
`mean_action` is the expert's mean action, `actions` are the executed actions.

```python
import robomimic.utils.obs_utils as ObsUtils
from robomimic.utils.dataset import SequenceDataset

ObsUtils.initialize_obs_utils_with_obs_specs({"obs": {"rgb": ["image"], "low_dim": ["proprio"]}})
dataset = SequenceDataset(
    "<this folder>/myo-reach.hdf5", obs_keys=["image", "proprio"], dataset_keys=["actions"], filter_by_attribute="train"
)
```

Replay the episodes in the simulator: `python -m acgd replay <this folder>`.
"""
