"""The page: one self-contained html file from the evidence, the figures and the films."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml
from jinja2 import Environment, FileSystemLoader, StrictUndefined

from acgd.reports import ledger, numbers, success, tables, verdict
from acgd.reports.evidence import Artifacts, Evidence
from acgd.reports.media import Film
from acgd.reports.settings import ReportRequest
from acgd.reports.style import colours, inline

HERE = Path(__file__).parent
CODEBOOK = {
    "variants": "variants", "seeds": "seed", "perplexity": "perplexity", "codes": "of codes", "groups": "groups", "bits": "bits per chunk",
    "error_training": "error, training", "error_validation": "error, held out", "error_shuffled": "with shuffled codes", "shuffled_ratio": "ratio",
}  # fmt: skip


def render(
    request: ReportRequest, evidence: Evidence, svgs: Mapping[str, str], films: Sequence[Film], artifacts: Artifacts
) -> str:
    """The html text. It refers to nothing outside itself."""
    environment = Environment(
        loader=FileSystemLoader(HERE), autoescape=True, trim_blocks=True, lstrip_blocks=True, undefined=StrictUndefined
    )
    return environment.get_template("report.html.j2").render(
        request=request,
        css=(HERE / "report.css").read_text(encoding="utf-8"),
        figures={name: inline(text, name) for name, text in svgs.items()},
        films=films,
        filmed=any(film.success or film.failure for film in films),
        story=_story(request, evidence),
        cards=_cards(request, evidence),
        tables=_tables(request, evidence),
        settings=_settings(request, artifacts),
    )


def _story(request: ReportRequest, evidence: Evidence) -> dict[str, object]:
    """The sentences."""
    rule = request.report.success
    pooled, mean = success.pooled(evidence.success, rule), success.over_tasks(evidence.success, rule)
    is_visual, told = verdict.visual(evidence.images)
    return {
        "compared": verdict.compared(request, evidence.episodes),
        "answers": verdict.answers(request, evidence.paired, mean, evidence.baseline),
        "exceptions": verdict.exceptions(evidence.paired, rule),
        "idle": verdict.idle_guidance(evidence.guidance),
        "is_visual": is_visual,
        "visual": told,
        "replay": verdict.replay(pooled, request.tasks),
        "baseline": evidence.baseline,
    }


def _cards(request: ReportRequest, evidence: Evidence) -> list[dict[str, str]]:
    """Per variant its success over all tasks: what most readers look for first."""
    mean = success.over_tasks(evidence.success, request.report.success)
    students = mean[mean["kind"] == "student"]
    shades = colours(list(dict.fromkeys(entry.variant for entry in request.entries)))
    cards = []
    for row in students.itertuples():
        interval = numbers.bracket(row.low, row.high).strip()
        cards.append(
            {
                "name": row.variant,
                "value": f"{row.rate:.2f}",
                "interval": interval,
                "seeds": row.seeds,
                "colour": shades[row.variant],
            }
        )
    return cards


def _tables(request: ReportRequest, evidence: Evidence) -> dict[str, tables.Table]:
    """Those that have a row."""
    rule = request.report.success
    pooled, mean = success.pooled(evidence.success, rule), success.over_tasks(evidence.success, rule)
    made = {
        "success": tables.success(pooled, mean, request.tasks, ["student"]),
        "conditions": tables.success(pooled, mean, request.tasks, ["condition"]),
        "controls": tables.success(pooled, mean, request.tasks, ["control"]),
        "rules": tables.rules(evidence.success),
        "paired": tables.differences(evidence.paired, rule),
        "images": tables.drops(evidence.images),
        "experts": tables.experts(evidence.experts),
        "demonstrations": tables.demonstrations(evidence.demonstrations),
        "critics": tables.critics(evidence.critics),
        "guidance": tables.guidance(evidence.guidance),
        "backbone": tables.backbone(evidence.backbone),
        "codebook": tables.plain(evidence.codebook, CODEBOOK, names=("variants", "seeds")),
        "stages": tables.cost(ledger.per_stage(evidence.stages)),
        "artifacts": tables.artifacts(evidence.stages),
    }
    return {name: table for name, table in made.items() if table.rows}


def _settings(request: ReportRequest, artifacts: Artifacts) -> dict[str, object]:
    """The configuration as yaml, versions from the manifests, machines from the runs."""
    everything = [artifact for stage in artifacts.values() for artifact in stage]
    versions: dict[str, dict[str, None]] = {}
    for artifact in everything:
        for package, version in {**artifact.manifest.get("simulator", {}), **artifact.run.get("packages", {})}.items():
            versions.setdefault(package, {})[str(version)] = None
    machines = dict.fromkeys(text for artifact in everything if (text := _machine(artifact.run)))
    revisions = dict.fromkeys(artifact.run["revision"] for artifact in everything if artifact.run.get("revision"))
    return {
        "configuration": yaml.safe_dump(request.configuration, sort_keys=False, allow_unicode=True, width=120)
        if request.configuration
        else "",
        "versions": {package: ", ".join(found) for package, found in sorted(versions.items())},
        "machines": list(machines),
        "revisions": list(revisions),
    }


def _machine(run: dict[str, Any]) -> str:
    cores = f"{run['cores']} cores" if run.get("cores") else ""
    device, half = run.get("device", ""), "" if run.get("bfloat16", True) else "float32 for want of bfloat16"
    return ", ".join(
        text for text in (run.get("processor", ""), cores, "" if device == "cpu" else device, half) if text
    )
