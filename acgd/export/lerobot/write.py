"""LeRobotDataset v3.0: data/*.parquet, meta/info.json, stats.json, tasks.parquet and episodes/*.parquet, videos/*.mp4.

The layout is LeRobot's. This project adds meta/acgd.json and the columns `acgd/...` of meta/episodes, from which an
episode is replayed in the simulator. LeRobot ignores them.
"""

import json
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from acgd.export.lerobot import statistics
from acgd.export.lerobot.films import Films
from acgd.export.lerobot.settings import LeRobotSettings
from acgd.export.recording import Recording, Recordings, load_all
from acgd.store.store import ArtifactError

CAMERA = "observation.images.camera"
DATA = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
EPISODES = "meta/episodes/chunk-000/file-000.parquet"
VIDEO = "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4"
FILES_PER_CHUNK, DATA_MB, VIDEO_MB = 1000, 100, 200
EXTRA = "acgd/"
"""Prefix of this project's columns in meta/episodes."""
IMAGE = pa.struct({"bytes": pa.binary(), "path": pa.string()})


def write(settings: LeRobotSettings, artifacts: Sequence[Path], folder: Path) -> str:
    """Writes one dataset of all tasks."""
    tasks = load_all(artifacts)
    _check_sizes(tasks)
    dataset = _Dataset(settings, tasks, folder)
    for number, task in enumerate(tasks):
        for episode in task:
            dataset.add(number, episode)
    dataset.close()
    return USE.format(camera=CAMERA, tasks=len(tasks))


class _Dataset:
    """A dataset that is being written."""

    def __init__(self, settings: LeRobotSettings, tasks: list[Recordings], folder: Path) -> None:
        self.tasks, self.folder = tasks, folder
        self.size = tasks[0].image_size
        self.fps = round(1 / Counter(task.control_step for task in tasks).most_common(1)[0][0])
        self.width = max(task.size("state") for task in tasks)
        self.features = _features(tasks, self.width, self.size, settings.images == "mp4")
        self.schema = _schema(self.features)
        self.films = None
        if settings.images == "mp4":
            self.films = Films(self._film, self.size, self.fps, settings.crf)
            self.features[CAMERA]["info"] = _film_info(self.size, self.fps, self.films.pixel_format)
        self.frames, self.file, self.in_file = 0, 0, 0
        self.writer: pq.ParquetWriter | None = None
        self.rows: list[dict[str, Any]] = []
        self.statistics: list[dict[str, statistics.Statistics]] = []

    def add(self, number: int, episode: Recording) -> None:
        """Adds an episode of the task of that number."""
        columns, length = self._columns(number, episode), episode.length
        self._write(columns)
        row: dict[str, Any] = {
            "episode_index": len(self.rows),
            "tasks": [self.tasks[number].instruction],
            "length": length,
            "data/chunk_index": self.file // FILES_PER_CHUNK,
            "data/file_index": self.file % FILES_PER_CHUNK,
            "dataset_from_index": self.frames,
            "dataset_to_index": self.frames + length,
            "meta/episodes/chunk_index": 0,
            "meta/episodes/file_index": 0,
        }
        if self.films:
            film, start, stop = self.films.add(episode.steps["image"])
            row |= {f"videos/{CAMERA}/chunk_index": film // FILES_PER_CHUNK}
            row |= {f"videos/{CAMERA}/file_index": film % FILES_PER_CHUNK}
            row |= {f"videos/{CAMERA}/from_timestamp": start, f"videos/{CAMERA}/to_timestamp": stop}
        measured = {name: statistics.of_rows(value) for name, value in columns.items() if name != CAMERA}
        measured[CAMERA] = statistics.of_images(episode.steps["image"])
        row |= {f"stats/{n}/{s}": value.tolist() for n, stats in measured.items() for s, value in stats.items()}
        self.rows.append(row | self._extra(number, episode))
        self.statistics.append(measured)
        self.frames += length

    def close(self) -> None:
        """Closes the files, and writes what depends on all episodes."""
        if self.writer:
            self.writer.close()
        if self.films:
            self.films.close()
        words = [task.instruction for task in self.tasks]
        (self.folder / EPISODES).parent.mkdir(parents=True)
        pd.DataFrame({"task_index": range(len(words))}, index=words).to_parquet(self.folder / "meta/tasks.parquet")
        names = dict.fromkeys(name for row in self.rows for name in row)
        table = pa.table({name: pa.array([row.get(name) for row in self.rows]) for name in names})
        pq.write_table(table, self.folder / EPISODES)
        joined = {name: statistics.joined([one[name] for one in self.statistics]) for name in self.statistics[0]}
        self._json("stats", {name: {s: v.tolist() for s, v in stats.items()} for name, stats in joined.items()})
        self._json("info", self._info())
        self._json("acgd", {"tasks": {task.task.name: _described(task) for task in self.tasks}})

    def _columns(self, number: int, episode: Recording) -> dict[str, np.ndarray]:
        steps, length = episode.steps, episode.length
        frame = np.arange(length)
        state = np.pad(steps["state"], ((0, 0), (0, self.width - steps["state"].shape[1])))
        columns = {
            "observation.state": steps["proprio"],
            "observation.environment_state": state,
            "action": steps["action"],
            "next.reward": steps["reward"],
            "next.success": steps["solved"],
            "next.done": frame == length - 1,
            "expert.action": steps.get("mean_action"),
            "expert.acted": steps.get("by_expert"),
            "timestamp": (frame / self.fps).astype(np.float32),
            "frame_index": frame,
            "episode_index": np.full(length, len(self.rows)),
            "index": self.frames + frame,
            "task_index": np.full(length, number),
        }
        if self.films is None:
            columns[CAMERA] = [_png(image) for image in steps["image"]]
        return {name: columns[name] for name in self.schema.names}

    def _write(self, columns: dict[str, Any]) -> None:
        arrays = [_array(columns[field.name], field.type) for field in self.schema]
        table = pa.Table.from_arrays(arrays, schema=self.schema)
        if self.writer and self.in_file + table.nbytes > DATA_MB * 2**20:
            self.writer.close()
            self.writer, self.file, self.in_file = None, self.file + 1, 0
        if self.writer is None:
            at = {"chunk_index": self.file // FILES_PER_CHUNK, "file_index": self.file % FILES_PER_CHUNK}
            path = self.folder / DATA.format(**at)
            path.parent.mkdir(parents=True, exist_ok=True)
            self.writer = pq.ParquetWriter(path, self.schema, compression="snappy")
        self.writer.write_table(table)
        self.in_file += table.nbytes

    def _extra(self, number: int, episode: Recording) -> dict[str, Any]:
        task = self.tasks[number].task
        extra = {"task": task.name, "start": task.start, "seed": episode.seed, **episode.outcome}
        extra |= {"integration": episode.steps["integration"][0].tolist()}
        extra |= {f"model_fields/{name}": value.ravel().tolist() for name, value in episode.model_fields.items()}
        return {EXTRA + name: value for name, value in extra.items()}

    def _info(self) -> dict[str, Any]:
        return {
            "codebase_version": "v3.0",
            "robot_type": self.tasks[0].task.name.split("/")[0],
            "total_episodes": len(self.rows),
            "total_frames": self.frames,
            "total_tasks": len(self.tasks),
            "chunks_size": FILES_PER_CHUNK,
            "data_files_size_in_mb": DATA_MB,
            "video_files_size_in_mb": VIDEO_MB,
            "fps": self.fps,
            "splits": {"train": f"0:{len(self.rows)}"},
            "data_path": DATA,
            "video_path": VIDEO if self.films else None,
            "features": self.features,
        }

    def _film(self, number: int) -> Path:
        at = {"chunk_index": number // FILES_PER_CHUNK, "file_index": number % FILES_PER_CHUNK}
        return self.folder / VIDEO.format(video_key=CAMERA, **at)

    def _json(self, name: str, content: dict[str, Any]) -> None:
        (self.folder / f"meta/{name}.json").write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


def _check_sizes(tasks: list[Recordings]) -> None:
    """Raises ArtifactError where sizes of features differ between tasks. Only the privileged state is padded."""
    for what, sizes in (
        ("image", [task.image_size for task in tasks]),
        ("proprio", [task.size("proprio") for task in tasks]),
        ("action", [task.size("action") for task in tasks]),
    ):
        if len(set(sizes)) > 1:
            raise ArtifactError(
                f"the tasks {', '.join(task.task.name for task in tasks)} differ in the size of {what} ({sizes}): "
                "export each suite by itself"
            )
    for name in ("mean_action", "by_expert"):
        if len({name in task.stored for task in tasks}) > 1:
            raise ArtifactError(f"only some of these artifacts have {name}: export demonstrations and rounds apart")


def _features(tasks: list[Recordings], width: int, size: int, films: bool) -> dict[str, dict[str, Any]]:
    first = tasks[0]
    columns = [f"{name}_{i}" for name, (start, stop) in first.names.items() for i in range(stop - start)]
    proprio, actions = first.size("proprio"), first.size("action")
    features = {
        CAMERA: _feature("video" if films else "image", [size, size, 3], ["height", "width", "channels"]),
        "observation.state": _feature("float32", [proprio], columns[:proprio]),
        "observation.environment_state": _feature("float32", [width], columns if len(tasks) == 1 else None),
        "action": _feature("float32", [actions], [f"actuator_{i}" for i in range(actions)]),
        "next.reward": _feature("float32", [1]),
        "next.success": _feature("bool", [1]),
        "next.done": _feature("bool", [1]),
    }
    if "mean_action" in first.stored:
        features["expert.action"] = _feature("float32", [actions])
    if "by_expert" in first.stored:
        features["expert.acted"] = _feature("bool", [1])
    whole = {name: _feature("int64", [1]) for name in ("frame_index", "episode_index", "index", "task_index")}
    return features | {"timestamp": _feature("float32", [1])} | whole


def _feature(dtype: str, shape: list[int], names: list[str] | None = None) -> dict[str, Any]:
    return {"dtype": dtype, "shape": shape, "names": names}


def _schema(features: dict[str, dict[str, Any]]) -> pa.Schema:
    """Columns of the parquet files, which hold no films."""
    plain = {"float32": pa.float32(), "int64": pa.int64(), "bool": pa.bool_()}

    def column(feature: dict[str, Any]) -> pa.DataType:
        if feature["dtype"] == "image":
            return IMAGE
        kind, (size, *_) = plain[feature["dtype"]], feature["shape"]
        return kind if size == 1 else pa.list_(kind, size)

    return pa.schema([(name, column(f)) for name, f in features.items() if f["dtype"] != "video"])


def _array(values: Any, kind: pa.DataType) -> pa.Array:
    if pa.types.is_fixed_size_list(kind):
        return pa.FixedSizeListArray.from_arrays(pa.array(np.ascontiguousarray(values).ravel()), kind.list_size)
    return pa.array(values, type=kind)


def _png(image: np.ndarray) -> dict[str, Any]:
    """An image as PNG. OpenCV expects the channels in reverse order."""
    written, content = cv2.imencode(".png", image[..., ::-1], [cv2.IMWRITE_PNG_COMPRESSION, 3])
    if not written:
        raise RuntimeError("OpenCV cannot write PNG")
    return {"bytes": content.tobytes(), "path": None}


def _film_info(size: int, fps: int, pixel_format: str) -> dict[str, Any]:
    video = {"height": size, "width": size, "codec": "h264", "pix_fmt": pixel_format, "fps": fps, "channels": 3}
    return {f"video.{name}": value for name, value in video.items()} | {"video.is_depth_map": False, "has_audio": False}


def _described(task: Recordings) -> dict[str, Any]:
    shapes = {name: list(value.shape) for name, value in next(iter(task)).model_fields.items()}
    return {
        "instruction": task.instruction,
        "control_step": task.control_step,
        "state": task.names,
        "state_size": task.size("state"),
        "model_fields": shapes,
    }


USE = """\
LeRobotDataset v3.0 with {tasks} task(s). `observation.state` is the robot's proprioception, `{camera}` the camera
image. `observation.environment_state` is the privileged state, zero-padded to the widest task's: a policy that acts
from images must not read it. `expert.action` is the expert's mean action, `action` the executed action. `index` and
`timestamp` count control steps. Where tasks differ in their control step, `fps` is that of most tasks, and
meta/acgd.json has the control step of each task.

```python
from lerobot.datasets.lerobot_dataset import LeRobotDataset

dataset = LeRobotDataset("acgd/demonstrations", root="<this folder>")
```

The columns `acgd/...` of meta/episodes hold each episode's seed, outcome and start. Replay it in the simulator:
`python -m acgd replay <this folder>`.
"""
