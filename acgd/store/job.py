"""Makes one artifact. The workflow starts a process for each."""

import json
import os
import platform
import resource
import subprocess
import sys
import time
from collections.abc import Callable, Collection, Mapping
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

from acgd.settings import Request, imported, values_of
from acgd.store.atomic import replace_text
from acgd.store.key import InputKeys, canonical, key_of
from acgd.store.stage import Context, Inputs, Stage
from acgd.store.store import ArtifactError, Store, Workspace, check

if TYPE_CHECKING:
    import torch

Identify = Callable[[Stage, Request, InputKeys], dict[str, Any]]
"""(stage, request, keys of the inputs) -> the identity, whose hash is the key."""


def make(job: Mapping[str, Any], stage: Stage, identify: Identify, store: Store, threads: int, device: str) -> None:
    """Makes the artifact that `job` (Artifact.job) describes, unless the store has it.

    Raises ArtifactError where the key no longer fits the code, or an input is missing or damaged.
    """
    place = f"{stage.name}/{job['name']}/{job['key']}"
    request = imported(stage.request).model_validate(job["request"])
    identity = identify(stage, request, _keys(job["inputs"]))
    if key_of(identity) != job["key"]:
        raise ArtifactError(
            f"{place}: code, simulator or a file that it reads has changed since the workflow was started. "
            "Start the workflow again."
        )
    inputs = _inputs(job["inputs"], store, restored=stage.name == "report")

    def fill(space: Workspace) -> dict[str, Any]:
        started = time.time()
        resumed = any(space.state.iterdir())
        _log(place, "going on from its checkpoint" if resumed else "started")
        context = _context(space, threads, device)
        with context.metrics:
            imported(stage.function)(request, inputs, context)
        return {
            **_usage(started, resumed),
            **_machine(threads, context.device),
            "precision_used": _precision(request, context.device),
        }

    made = store.make(place, identity, fill, job.get("again", False))
    _log(place, f"made in {store.path(place)}" if made else "is there already")


def _keys(inputs: Mapping[str, Any]) -> dict[str, Any]:
    """Role -> key, or keys: the last part of each place `<stage>/<name>/<key>`."""
    return {
        role: [Path(place).name for place in places] if isinstance(places, list) else Path(places).name
        for role, places in inputs.items()
    }


def _inputs(inputs: Mapping[str, Any], store: Store, restored: bool) -> Inputs:
    """Role -> path, or paths, of checked artifacts. `restored`: whether the stage accepts restored artifacts."""
    paths = {
        role: [store.path(place) for place in places] if isinstance(places, list) else store.path(places)
        for role, places in inputs.items()
    }
    for group in paths.values():
        for path in group if isinstance(group, list) else [group]:
            check(path, restored)
    return paths


def _context(space: Workspace, threads: int, device: str) -> Context:
    """The context of a stage. Raises ArtifactError where the device is cuda and torch sees no GPU."""
    import torch

    from acgd.store.metrics import Metrics
    from acgd.store.progress import Progress

    torch.set_num_threads(threads)
    device_type = ("cuda" if torch.cuda.is_available() else "cpu") if device == "auto" else device
    if device_type == "cuda" and not torch.cuda.is_available():
        raise ArtifactError(
            "device: cuda, but torch sees no GPU. Set device: auto or cpu, or install a torch with CUDA and its driver."
        )
    return Context(
        out=space.payload,
        state=space.state,
        metrics=Metrics(space.metrics),
        progress=Progress(),
        device=torch.device(device_type),
    )


def _usage(started: float, resumed: bool) -> dict[str, Any]:
    """Time (s) and memory (bytes) of this process. After a kill both count from the last start."""
    process, children = resource.getrusage(resource.RUSAGE_SELF), resource.getrusage(resource.RUSAGE_CHILDREN)
    return {
        "started": started,
        "wall_s": time.time() - started,
        "cpu_s": process.ru_utime + process.ru_stime + children.ru_utime + children.ru_stime,
        "peak_rss_bytes": 1024 * max(process.ru_maxrss, children.ru_maxrss),
        "resumed": resumed,
    }


def _machine(threads: int, device: "torch.device") -> dict[str, Any]:
    from acgd.store.precision import has_bfloat16

    packages = ("torch", "numpy", "mujoco", "myosuite", "zarr")
    return {
        "machine": platform.node(),
        "system": platform.platform(),
        "processor": _processor(),
        "cores": os.cpu_count(),
        "threads": threads,
        "device": str(device),
        "bfloat16": has_bfloat16(device),
        "python": platform.python_version(),
        "packages": {package: version(package) for package in packages},
        "revision": _revision(),
    }


def _precision(request: Request, device: "torch.device") -> str | None:
    """The precision that the stage computed in, or None where its settings name none.

    bfloat16 falls back to float32 on hardware without it.
    """
    from acgd.store.precision import has_bfloat16

    configured = set(values_of("precision", request.model_dump()))
    if "bfloat16" in configured:
        return "bfloat16" if has_bfloat16(device) else "float32"
    return "float32" if configured else None


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor()
    return next((line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")), platform.machine())


def _revision() -> str | None:
    """Git revision of the code, with a + where files differ from the revision; None outside a checkout."""
    folder = str(Path(__file__).parent)
    command = ["git", "-C", folder, "describe", "--always", "--abbrev=12", "--dirty=+", "--exclude=*"]
    try:
        return subprocess.run(command, capture_output=True, text=True, check=True, timeout=20).stdout.strip()
    except (OSError, subprocess.SubprocessError):
        return None


def _log(place: str, event: str) -> None:
    sys.stderr.write(f"{place}: {event}\n")  # one call: parallel jobs share the terminal
    sys.stderr.flush()


def request_file(store: Store, place: str) -> Path:
    """The file in which the workflow describes the artifact that a job makes."""
    return store.work(place) / "request.json"


def write_requests(store: Store, jobs: Mapping[str, str], again: Collection[str] = ()) -> None:
    """Writes a request file for each artifact that the store lacks. `jobs`: place -> Artifact.job.

    again: places of artifacts that are made again; their requests say so.
    """
    for place, job in jobs.items():
        if place in again:
            replace_text(request_file(store, place), canonical({**json.loads(job), "again": True}))
        elif not store.has(place):
            replace_text(request_file(store, place), job)


def read_request(file: Path) -> dict[str, Any]:
    """The job in a request file. Raises ArtifactError where the file is no request."""
    try:
        job = json.loads(file.read_text(encoding="utf-8"))
        missing = {"stage", "name", "key", "request", "inputs"} - set(job)
    except (OSError, ValueError, TypeError):
        missing = {"everything"}
    if missing:
        raise ArtifactError(
            f"{file} is no request: it lacks {', '.join(sorted(missing))}. "
            "The workflow writes it: snakemake --cores 2 <target>."
        )
    return job
