"""Reads datasets of LeRobotDataset v3.0, written by `acgd export` or by LeRobot."""

import json
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path
from typing import Any

import cv2
import imageio_ffmpeg
import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from acgd.rollouts.formats.episode import Beginning, OutsideEpisode, UnreadableError

OUTCOMES = ("success_final", "success_held", "success_once", "terminated")
EXTRA = "acgd/"


def episodes(folder: Path, *, images: bool = True) -> Iterator[OutsideEpisode]:
    """The episodes of a dataset in their order. Columns have the names of the features."""
    info = _info(folder)
    extra = folder / "meta/acgd.json"
    tasks = json.loads(extra.read_text())["tasks"] if extra.is_file() else {}
    files = sorted((folder / "meta/episodes").glob("*/*.parquet"))
    try:
        rows = [row for file in files for row in pq.read_table(file).to_pylist()]
        for row in sorted(rows, key=lambda row: row["episode_index"]):
            columns = _columns(folder, info, row, images)
            yield OutsideEpisode(_task(folder, row), columns, _beginning(row, tasks))
    except (pa.ArrowException, KeyError, OSError) as error:
        raise UnreadableError(f"{folder} cannot be read as a LeRobotDataset: {error}") from error


def _info(folder: Path) -> dict[str, Any]:
    file = Path(folder) / "meta/info.json"
    try:
        info = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise UnreadableError(f"{folder} is no LeRobotDataset: {file} cannot be read ({error})") from error
    if not info.get("codebase_version", "").startswith("v3."):
        raise UnreadableError(
            f"{folder} is a LeRobotDataset {info.get('codebase_version')}; v3.0 is read: convert it with LeRobot"
        )
    return info


def _columns(folder: Path, info: dict[str, Any], row: dict[str, Any], images: bool) -> dict[str, np.ndarray]:
    at = {"chunk_index": row["data/chunk_index"], "file_index": row["data/file_index"]}
    table = _table(folder / info["data_path"].format(**at))
    steps = np.flatnonzero(table["episode_index"].to_numpy() == row["episode_index"])
    rows = table.slice(int(steps[0]), len(steps))
    columns = {}
    for name, feature in info["features"].items():
        if feature["dtype"] in ("image", "video") and not images:
            continue
        if feature["dtype"] == "video":
            columns[name] = _film(folder, info, row, name)
        elif feature["dtype"] == "image":
            columns[name] = np.stack([_picture(cell["bytes"]) for cell in rows[name].to_pylist()])
        elif feature["dtype"] != "string":
            flat = rows[name].combine_chunks()
            while isinstance(flat, pa.ListArray | pa.FixedSizeListArray | pa.ExtensionArray):
                flat = flat.storage if isinstance(flat, pa.ExtensionArray) else flat.flatten()
            shape = () if tuple(feature["shape"]) == (1,) else feature["shape"]
            columns[name] = flat.to_numpy(zero_copy_only=False).reshape(len(steps), *shape)
    return columns


@lru_cache(maxsize=1)
def _table(file: Path) -> pa.Table:
    return pq.read_table(file)


def _picture(content: bytes) -> np.ndarray:
    return cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_COLOR)[..., ::-1]


def _film(folder: Path, info: dict[str, Any], row: dict[str, Any], name: str) -> np.ndarray:
    at = {part: row[f"videos/{name}/{part}"] for part in ("chunk_index", "file_index")}
    path = folder / info["video_path"].format(video_key=name, **at)
    first, length = round(row[f"videos/{name}/from_timestamp"] * info["fps"]), row["length"]
    return _frames(path)[first : first + length]


@lru_cache(maxsize=1)
def _frames(path: Path) -> np.ndarray:
    reader = imageio_ffmpeg.read_frames(str(path), pix_fmt="rgb24")
    width, height = next(reader)["size"]
    return np.stack([np.frombuffer(frame, np.uint8).reshape(height, width, 3) for frame in reader])


def _task(folder: Path, row: dict[str, Any]) -> str:
    return row["tasks"][0] if row.get("tasks") else str(pd.read_parquet(folder / "meta/tasks.parquet").index[0])


def _beginning(row: dict[str, Any], tasks: dict[str, Any]) -> Beginning | None:
    name = row.get(EXTRA + "task")
    if name not in tasks:
        return None
    fields = {
        field: np.array(row[f"{EXTRA}model_fields/{field}"]).reshape(shape)
        for field, shape in tasks[name]["model_fields"].items()
    }
    return Beginning(
        task={"name": name, "start": row[EXTRA + "start"]},
        seed=row[EXTRA + "seed"],
        outcome={rule: row[EXTRA + rule] for rule in OUTCOMES},
        integration=np.array(row[EXTRA + "integration"]),
        model_fields=fields,
    )
