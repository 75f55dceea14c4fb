"""Run by the Python of scripts/peer-environment.sh: reads an export with the library that it is for.

    python peers_read.py lerobot|robomimic|minari <folder> <result.npz>

The result holds `<episode>/<name>` -> array, name being action, proprio, state or image, and what the library says of
the whole.
"""

import json
import os
import sys
import warnings

import numpy as np
import torch

warnings.simplefilter("ignore")

# torchvision's wheel is built for CUDA: beside a CPU build of torch its operators do not load, and without these two it
# cannot be imported. Nothing here uses them.
OPERATORS = torch.library.Library("torchvision", "FRAGMENT")
if "+cpu" in torch.__version__:
    for operator in ("nms", "qnms"):
        OPERATORS.define(f"{operator}(Tensor dets, Tensor scores, float iou_threshold) -> Tensor")


def lerobot(folder):
    from lerobot.datasets.lerobot_dataset import LeRobotDataset
    from lerobot.datasets.utils import dataset_to_policy_features

    dataset = LeRobotDataset("acgd/demonstrations", root=folder)
    result = {}
    for row in dataset.meta.episodes:
        items = [dataset[i] for i in range(row["dataset_from_index"], row["dataset_to_index"])]
        names = {"action": "action", "observation.state": "proprio", "observation.environment_state": "state"}
        for name, short in names.items():
            result[f"{row['episode_index']}/{short}"] = np.stack([item[name].numpy() for item in items])
        image = torch.stack([item["observation.images.camera"] for item in items])
        result[f"{row['episode_index']}/image"] = image.mul(255).round().byte().permute(0, 2, 3, 1).numpy()
        result[f"{row['episode_index']}/task"] = np.array(items[0]["task"])
    features = {name: [f.type.name, list(f.shape)] for name, f in dataset_to_policy_features(dataset.features).items()}
    result["features"] = np.array(json.dumps(features))
    result["mean"] = dataset.meta.stats["action"]["mean"]
    window = LeRobotDataset(
        "acgd/demonstrations", root=folder, delta_timestamps={"action": [i / dataset.fps for i in range(4)]}
    )
    result["chunk"] = window[0]["action"].numpy()
    return result


def robomimic(folder):
    import robomimic.utils.obs_utils as obs_utils
    from robomimic.utils.dataset import SequenceDataset
    from robomimic.utils.file_utils import get_env_metadata_from_dataset, get_shape_metadata_from_dataset

    obs_utils.initialize_obs_utils_with_obs_specs({"obs": {"rgb": ["image"], "low_dim": ["proprio", "state"]}})
    result = {}
    (file,) = [os.path.join(folder, name) for name in os.listdir(folder) if name.endswith(".hdf5")]
    dataset = SequenceDataset(file, obs_keys=["image", "proprio", "state"], dataset_keys=["actions", "states"])
    at = 0
    for episode, demo in enumerate(dataset.demos):
        length = int(dataset.get_dataset_for_ep(demo, "actions").shape[0])
        items = [dataset[at + i] for i in range(length)]
        result[f"{episode}/action"] = np.stack([item["actions"][0] for item in items])
        for name in ("proprio", "state", "image"):
            result[f"{episode}/{name}"] = np.stack([item["obs"][name][0] for item in items])
        result[f"{episode}/next_proprio"] = np.stack([item["next_obs"]["proprio"][0] for item in items])
        at += length
    for mask in ("train", "valid"):
        chosen = SequenceDataset(file, obs_keys=["proprio"], dataset_keys=["actions"], filter_by_attribute=mask)
        result[mask] = np.array([int(name.removeprefix("demo_")) for name in chosen.demos])
    result["env"] = np.array(json.dumps(get_env_metadata_from_dataset(file)))
    shapes = get_shape_metadata_from_dataset(file, all_obs_keys=["image", "proprio"])
    result["shapes"] = np.array([*shapes["all_shapes"]["image"], shapes["ac_dim"]])
    return result


def minari(folder):
    os.environ["MINARI_DATASETS_PATH"] = str(folder)
    import minari as library

    (name,) = library.list_local_datasets()
    dataset = library.load_dataset(name)
    result = {"name": np.array(name), "env": np.array(dataset.env_spec.to_json())}
    for episode in dataset:
        result[f"{episode.id}/action"] = episode.actions
        for entry in ("proprio", "state", "image"):
            result[f"{episode.id}/{entry}"] = episode.observations[entry]
        assert dataset.observation_space["image"].contains(episode.observations["image"][0])
    result["steps"] = np.array(dataset.total_steps)
    result["seeds"] = np.array([m["seed"] for m in dataset.storage.get_episode_metadata(dataset.episode_indices)])
    return result


if __name__ == "__main__":
    np.savez(sys.argv[3], **globals()[sys.argv[1]](sys.argv[2]))
