"""Pictures and films as data URIs. The page needs no other file."""

import base64
from dataclasses import dataclass

import cv2
import numpy as np
import zarr

from acgd.reports.artifact import Artifact, Artifacts
from acgd.reports.ledger import used
from acgd.reports.settings import ReportRequest


@dataclass(frozen=True)
class Clip:
    """A film of one episode of a student, as a data URI."""

    uri: str
    source: str
    """Variant and student seed."""


@dataclass(frozen=True)
class Film:
    """Picture and clips of one task."""

    task: str
    picture: str | None
    """A frame of a demonstration, as a data URI."""
    success: Clip | None
    failure: Clip | None


def films(request: ReportRequest, artifacts: Artifacts) -> list[Film]:
    """Per task a success and a failure, each from the first student in the study's order that has one."""
    films = []
    for task_id, task in enumerate(request.tasks):
        clips = {
            kind: _clip(request, artifacts, f"{task.replace('/', '-')}-{kind}.mp4") for kind in ("success", "failure")
        }
        rollouts = (used(entry, "rollouts", artifacts) for entry in request.entries)
        first = next((by_task[task_id] for by_task in rollouts if by_task), None)
        films.append(Film(task, first and picture(first), clips["success"], clips["failure"]))
    return films


def picture(rollouts: Artifact) -> str | None:
    """The last frame of the first demonstration as a png data URI."""
    store = rollouts.path / "rollouts.zarr"
    if not store.exists():
        return None
    image = np.asarray(zarr.open_group(store, mode="r")["final_image"][0])
    encoded = cv2.imencode(".png", cv2.cvtColor(image, cv2.COLOR_RGB2BGR))[1]
    return _uri("image/png", encoded.tobytes())


def _clip(request: ReportRequest, artifacts: Artifacts, file: str) -> Clip | None:
    if not request.report.clips:
        return None
    for entry in request.entries:
        for clips in used(entry, "clips", artifacts):
            for path in clips.path.rglob(file):
                return Clip(_uri("video/mp4", path.read_bytes()), f"{entry.variant}, student seed {entry.seed}")
    return None


def _uri(kind: str, content: bytes) -> str:
    return f"data:{kind};base64,{base64.b64encode(content).decode()}"
