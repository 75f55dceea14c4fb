"""Reads Minari's HDF5 datasets whose spaces are arrays, such as those of `acgd export`."""

import json
from collections.abc import Iterator
from pathlib import Path

import h5py

from acgd.rollouts.formats.episode import Beginning, OutsideEpisode, UnreadableError


def episodes(folder: Path, *, images: bool = True) -> Iterator[OutsideEpisode]:
    """The episodes of all datasets below a folder. `observations/<name>` are (T + 1, ...), the final one last."""
    for file in sorted(Path(folder).rglob("metadata.json")):
        try:
            metadata = json.loads(file.read_text(encoding="utf-8"))
            with h5py.File(file.with_name("main_data.hdf5")) as content:
                yield from _episodes(content, metadata, images)
        except (OSError, KeyError, ValueError) as error:
            raise UnreadableError(f"{file.parent} cannot be read as a dataset of Minari: {error}") from error


def _episodes(file: h5py.File, metadata: dict, images: bool) -> Iterator[OutsideEpisode]:
    specification = json.loads(metadata["env_spec"])
    for number in range(metadata["total_episodes"]):
        group = file[f"episode_{number}"]
        columns = {name: group[name][()] for name in ("actions", "rewards", "terminations", "truncations")}
        for part in ("observations", "infos"):
            read = {f"{part}/{name}": value for name, value in group[part].items()}
            columns |= {name: value[()] for name, value in read.items() if images or value.ndim != 4}
        beginning = None
        if "acgd" in group:
            extra = group["acgd"]
            beginning = Beginning(
                task=specification["kwargs"]["task"],
                seed=int(group.attrs["seed"]),
                outcome={name: bool(value) for name, value in json.loads(extra.attrs["outcome"]).items()},
                integration=extra["integration"][()],
                model_fields={name: value[()] for name, value in extra["model_fields"].items()},
            )
        yield OutsideEpisode(specification["id"], columns, beginning)
