"""Makes one artifact, in the process that the workflow starts for it."""

import json
import os
import platform
import resource
import subprocess
import sys
import time
from collections.abc import Mapping
from importlib import import_module
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

from acgd.experts import zoo
from acgd.store.atomic import replace_file
from acgd.store.key import identity, key_of
from acgd.store.stage import Context, Inputs
from acgd.store.store import ArtifactError, Store, Workspace, check
from acgd.study.plan import Plan

if TYPE_CHECKING:
    import torch

STAGES: dict[str, tuple[str, str]] = {
    "expert": ("acgd.experts.settings:ExpertRequest", "acgd.experts.train:train"),
    "critic": ("acgd.critics.settings:CriticRequest", "acgd.critics.fit:fit"),
    "rollouts": ("acgd.collection.settings:RolloutsRequest", "acgd.collection.collect:collect"),
    "backbone": ("acgd.vision.settings:BackboneRequest", "acgd.vision.train:train"),
    "features": ("acgd.vision.settings:FeaturesRequest", "acgd.vision.encode:encode"),
    "codebook": ("acgd.students.settings:CodebookRequest", "acgd.students.fit_codebook:fit"),
    "student": ("acgd.students.settings:StudentRequest", "acgd.students.distil:distil"),
    "evaluation": ("acgd.evaluation.settings:EvaluationRequest", "acgd.evaluation.evaluate:evaluate"),
    "controls": ("acgd.evaluation.settings:ControlsRequest", "acgd.evaluation.controls:controls"),
    "report": ("acgd.reports.settings:ReportRequest", "acgd.reports.report:report"),
}
"""Stage -> what it is asked, and the function that answers. Imported only where it runs."""


def make(job: Mapping[str, Any], store: Store, threads: int, device: str) -> None:
    """Makes the artifact that `job` (Artifact.job) describes, unless it is there."""
    stage, place = job["stage"], f"{job['stage']}/{job['name']}/{job['key']}"
    request_type, function = STAGES[stage]
    request = _imported(request_type).model_validate(job["request"])
    described = identity(stage, request, _keys(job["inputs"]), zoo.read_by(stage, request))
    if key_of(described) != job["key"]:
        raise ArtifactError(
            f"{place}: code, simulator or a file that it reads has changed since the workflow was started. Start it again."
        )
    inputs = _inputs(job["inputs"], store, restored=stage == "report")

    def fill(space: Workspace) -> dict[str, Any]:
        started = time.time()
        resumed = any(space.state.iterdir())
        _say(place, "going on from its checkpoint" if resumed else "started")
        context = _context(space, threads, device)
        with context.metrics:
            _imported(function)(request, inputs, context)
        return {**_usage(started, resumed), **_machine(threads, context.device)}

    made = store.make(place, described, fill)
    _say(place, f"made in {store.path(place)}" if made else "is there already")


def _keys(inputs: Mapping[str, Any]) -> dict[str, Any]:
    return {
        role: [Path(one).name for one in given] if isinstance(given, list) else Path(given).name
        for role, given in inputs.items()
    }


def _inputs(places: Mapping[str, Any], store: Store, restored: bool) -> Inputs:
    paths = {
        role: [store.path(one) for one in given] if isinstance(given, list) else store.path(given)
        for role, given in places.items()
    }
    for given in paths.values():
        for path in given if isinstance(given, list) else [given]:
            check(path, restored)
    return paths


def _context(space: Workspace, threads: int, device: str) -> Context:
    import torch

    from acgd.tracking.metrics import Metrics
    from acgd.tracking.progress import Progress

    torch.set_num_threads(threads)
    chosen = ("cuda" if torch.cuda.is_available() else "cpu") if device == "auto" else device
    if chosen == "cuda" and not torch.cuda.is_available():
        raise ArtifactError(
            "device: cuda, but torch sees no GPU. Set device: auto or cpu, or install a torch with CUDA and its driver."
        )
    return Context(
        out=space.payload,
        state=space.state,
        metrics=Metrics(space.metrics),
        progress=Progress(),
        device=torch.device(chosen),
    )


def _usage(started: float, resumed: bool) -> dict[str, Any]:
    """What the making cost. After a kill it counts from the last start."""
    used, children = resource.getrusage(resource.RUSAGE_SELF), resource.getrusage(resource.RUSAGE_CHILDREN)
    return {
        "started": started,
        "wall_s": time.time() - started,
        "cpu_s": used.ru_utime + used.ru_stime + children.ru_utime + children.ru_stime,
        "peak_rss_bytes": 1024 * max(used.ru_maxrss, children.ru_maxrss),
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


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor()
    return next((line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")), platform.machine())


def _revision() -> str | None:
    """Git revision of the code, with a + where files differ from it; none outside a checkout."""
    command = [
        "git",
        "-C",
        str(Path(__file__).parent),
        "describe",
        "--always",
        "--abbrev=12",
        "--dirty=+",
        "--exclude=*",
    ]
    try:
        return subprocess.run(command, capture_output=True, text=True, check=True, timeout=20).stdout.strip()
    except (OSError, subprocess.SubprocessError):
        return None


def _imported(name: str) -> Any:
    module, attribute = name.split(":")
    return getattr(import_module(module), attribute)


def _say(place: str, what: str) -> None:
    sys.stderr.write(f"{place}: {what}\n")  # one call: jobs side by side share the terminal
    sys.stderr.flush()


def request_file(store: Store, place: str) -> Path:
    """Where the workflow writes what a job is to make."""
    return store.work(place) / "request.json"


def write_requests(store: Store, plan: Plan) -> None:
    """A request for each artifact that is not there."""
    for place, artifact in plan.artifacts.items():
        if not store.has(place):
            replace_file(
                request_file(store, place), lambda draft, text=artifact.job: draft.write_text(text, encoding="utf-8")
            )


def read_request(file: Path) -> dict[str, Any]:
    try:
        job = json.loads(file.read_text(encoding="utf-8"))
        missing = {"stage", "name", "key", "request", "inputs"} - set(job)
    except (OSError, ValueError, TypeError):
        missing = {"everything"}
    if missing:
        raise ArtifactError(
            f"{file} is no request: it lacks {', '.join(sorted(missing))}. The workflow writes it: snakemake --cores 2 <target>."
        )
    return job
