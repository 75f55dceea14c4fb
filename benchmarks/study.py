"""Cost of the finished default study, from the run.json of its artifacts, and jobs of one more variant:
`python -m benchmarks.study`."""

import json
import re
import subprocess
import sys
import tempfile
from collections import Counter, defaultdict
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from acgd.store.store import RUN, Store
from acgd.study.load import read_yaml
from acgd.study.plan import plan
from acgd.study.study import load_study
from benchmarks.row import Row

MOST_MINUTES, MOST_GB = 20.0, 6.0
LONGEST_PAUSE_S = 60.0
"""Longest gap between two stages in seconds: the start of a process and the work of Snakemake. In a longer gap the
workflow did not run."""
WORKFLOW_JOBS = {"all", "publish", "mlflow", "report"}
"""Jobs of every run of the workflow."""
VARIANT_JOBS = {"student", "evaluation", "clips"}
"""Jobs of a variant that changes a student setting."""


class NotMeasured(Exception):
    """The study is not finished. The message names the mend."""


@dataclass(frozen=True)
class Job:
    """One artifact's entries in run.json."""

    stage: str
    started: float
    """Unix time, seconds."""
    seconds: float
    peak_bytes: int
    resumed: bool

    @property
    def ended(self) -> float:
        return self.started + self.seconds


def run(config: Path = Path("config.yaml"), results: Path = Path("results")) -> list[Row]:
    """Rows of wall time, memory, seconds per stage (ratio: share of the total), and jobs of one more variant."""
    jobs = _jobs(config, results)
    seconds = busy_seconds(jobs)
    gigabytes = peak_bytes(jobs) / 1e9
    resumed = sum(job.resumed for job in jobs)
    note = f" ({resumed} stages went on after a stop: only their last part is counted)" if resumed else ""
    rows = [
        Row(
            name="study/wall time",
            value=seconds / 60,
            unit="min",
            ratio=seconds / 60 / MOST_MINUTES,
            target=f"<= {MOST_MINUTES:.0f} min on two cores{note}",
            met=seconds / 60 <= MOST_MINUTES,
        ),
        Row(
            name="study/peak memory of stages at once",
            value=gigabytes,
            unit="GB",
            ratio=gigabytes / MOST_GB,
            target=f"< {MOST_GB:.0f} GB",
            met=gigabytes < MOST_GB,
        ),
    ]
    by_stage: dict[str, list[float]] = defaultdict(list)
    for job in jobs:
        by_stage[job.stage].append(job.seconds)
    total_seconds = sum(job.seconds for job in jobs)
    for stage, times in by_stage.items():
        rows.append(
            Row(
                name=f"study/{stage} x {len(times)}",
                value=sum(times),
                unit="s",
                ratio=sum(times) / total_seconds,
                target="",
                met=None,
            )
        )
    return [*rows, _one_more_variant(config, results, len(jobs))]


def busy_seconds(jobs: Iterable[Job]) -> float:
    """Seconds from the first start to the last end, without gaps longer than LONGEST_PAUSE_S."""
    total, end = 0.0, None
    for job in sorted(jobs, key=lambda job: job.started):
        if end is not None and job.started > end:
            total += job.started - end if job.started - end <= LONGEST_PAUSE_S else 0.0
        start = job.started if end is None else max(job.started, end)
        total += max(0.0, job.ended - start)
        end = job.ended if end is None else max(end, job.ended)
    return total


def peak_bytes(jobs: Iterable[Job]) -> int:
    """Largest sum of the peak memory of simultaneous stages, in bytes. It is an upper bound of the memory in use."""
    events = sorted(
        [(job.started, 1, job.peak_bytes) for job in jobs] + [(job.ended, 0, -job.peak_bytes) for job in jobs]
    )
    current = peak = 0
    for _, _, change in events:
        current += change
        peak = max(peak, current)
    return peak


def _jobs(config: Path, results: Path) -> list[Job]:
    study, store = load_study(read_yaml(config)), Store(results)
    needed = plan(study).artifacts
    missing = [place for place in needed if not store.has(place)]
    if missing:
        raise NotMeasured(
            f"{len(missing)} of {len(needed)} artifacts of study {study.name} are not made yet. Type: make demo"
        )
    return [_job(artifact.stage.name, store.path(place) / RUN) for place, artifact in needed.items()]


def _job(stage: str, file: Path) -> Job:
    run = json.loads(file.read_text(encoding="utf-8"))
    return Job(stage, run["started"], run["wall_s"], run["peak_rss_bytes"], run["resumed"])


def _one_more_variant(config: Path, results: Path, artifacts: int) -> Row:
    """Row of a dry run of the finished study with another alpha as a further variant."""
    content = read_yaml(config)
    content["variants"] = {**content.get("variants", {}), "one-more": {"guidance": {"alpha": 1.2345}}}
    with tempfile.NamedTemporaryFile("w", suffix=".yaml") as file:
        json.dump(content, file)
        file.flush()
        jobs = dry_run(Path(file.name), results.resolve().parent)
    seeds = len(load_study(content).seeds)
    variant_jobs = sum(jobs[rule] for rule in VARIANT_JOBS)
    other_jobs = {rule: count for rule, count in jobs.items() if rule not in VARIANT_JOBS | WORKFLOW_JOBS}
    return Row(
        name="study/jobs of one more variant",
        value=variant_jobs,
        unit="jobs",
        ratio=variant_jobs / artifacts,
        target=f"{seeds} students, their evaluations and clips, nothing upstream"
        f"{': but ' + str(other_jobs) if other_jobs else ''}",
        met=not other_jobs and variant_jobs == len(VARIANT_JOBS) * seeds,
    )


def dry_run(config: Path, folder: Path) -> Counter[str]:
    """Rule -> number of jobs that Snakemake would run in `folder`."""
    snakefile = Path(__file__).parent.parent / "workflow" / "Snakefile"
    command = [
        sys.executable,
        "-m",
        "snakemake",
        "--snakefile",
        str(snakefile),
        "--directory",
        str(folder),
        "--configfile",
        str(config.resolve()),
    ]
    completed = subprocess.run(
        [*command, "--cores", "2", "--dry-run", "--nolock", "all"], capture_output=True, text=True, check=False
    )
    text = completed.stdout + completed.stderr
    if completed.returncode:
        raise RuntimeError(f"snakemake's dry run failed:\n{text}")
    table = re.search(r"^job\s+count\n-.*\n((?:\S+\s+\d+\n)+)", text, re.MULTILINE)
    return Counter(
        {rule: int(count) for rule, count in re.findall(r"^(\S+)\s+(\d+)$", table[1], re.MULTILINE) if rule != "total"}
        if table
        else {}
    )


if __name__ == "__main__":
    for row in run():
        print(row)
