"""Reads HDF5 files of robomimic's layout, written by `acgd export` or by another project."""

import json
from collections.abc import Iterator
from pathlib import Path

import h5py
import numpy as np

from acgd.rollouts.formats.episode import Beginning, OutsideEpisode, UnreadableError


def episodes(path: Path, *, images: bool = True) -> Iterator[OutsideEpisode]:
    """The demonstrations of a file, or of all *.hdf5 files of a folder, in the order of their numbers.

    Columns have the names of the file: `actions`, `obs/<name>`, `rewards`, `states`, ... `next_obs` is not read.
    """
    for file in sorted(Path(path).glob("*.hdf5")) if Path(path).is_dir() else [Path(path)]:
        try:
            with h5py.File(file) as content:
                yield from _episodes(content, images)
        except (OSError, KeyError, ValueError) as error:
            raise UnreadableError(f"{file} cannot be read as a file of robomimic: {error}") from error


def _episodes(file: h5py.File, images: bool) -> Iterator[OutsideEpisode]:
    data = file["data"]
    environment = json.loads(data.attrs["env_args"])
    for name in sorted(data, key=lambda name: int(name.removeprefix("demo_"))):
        demo = data[name]
        columns = {key: demo[key][()] for key in demo if isinstance(demo[key], h5py.Dataset)}
        for key, value in demo["obs"].items():
            if images or value.ndim != 4:
                columns[f"obs/{key}"] = value[()]
        yield OutsideEpisode(environment["env_name"], columns, _beginning(demo, environment, columns))


def _beginning(demo: h5py.Group, environment: dict, columns: dict[str, np.ndarray]) -> Beginning | None:
    if "model_fields" not in demo:
        return None
    return Beginning(
        task=environment["env_kwargs"]["task"],
        seed=int(demo.attrs["seed"]),
        outcome={name: bool(value) for name, value in json.loads(demo.attrs["outcome"]).items()},
        integration=columns["states"][0],
        model_fields={name: value[()] for name, value in demo["model_fields"].items()},
    )
