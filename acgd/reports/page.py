"""The page: one self-contained html file with tables, figures and films."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import yaml
from jinja2 import Environment, FileSystemLoader, StrictUndefined

from acgd.reports import ledger, numbers, success, tables, verdict
from acgd.reports.artifact import Artifact, Artifacts
from acgd.reports.evidence import Evidence
from acgd.reports.media import Film
from acgd.reports.settings import ReportRequest
from acgd.reports.style import colours, inline

TEMPLATES = Path(__file__).parent
CODEBOOK = {
    "variants": "variants",
    "seeds": "seed",
    "perplexity": "perplexity",
    "codes": "of codes",
    "groups": "groups",
    "bits": "bits per chunk",
    "error_training": "error, training",
    "error_validation": "error, held out",
    "error_shuffled": "with shuffled codes",
    "shuffled_ratio": "ratio",
}


def render(
    request: ReportRequest, evidence: Evidence, svgs: Mapping[str, str], films: Sequence[Film], artifacts: Artifacts
) -> str:
    """The html text. It has no reference to other files or addresses."""
    environment = Environment(
        loader=FileSystemLoader(TEMPLATES),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=StrictUndefined,
    )
    return environment.get_template("report.html.j2").render(
        request=request,
        css=(TEMPLATES / "report.css").read_text(encoding="utf-8"),
        figures={name: inline(text, name) for name, text in svgs.items()},
        films=films,
        filmed=any(film.success or film.failure for film in films),
        story=_story(request, evidence, artifacts),
        cards=_cards(request, evidence),
        tables=_tables(request, evidence),
        settings=_settings(request, artifacts),
    )


def _story(request: ReportRequest, evidence: Evidence, artifacts: Artifacts) -> dict[str, object]:
    """Sentences and thresholds of the page."""
    rule = request.report.success
    pooled, mean = success.pooled(evidence.success, rule), success.over_tasks(evidence.success, rule)
    is_visual, visual = verdict.visual(evidence.images)
    reliable_rank, counts_from = (numbers.common(evidence.guidance[name]) for name in ("reliable_rank", "counts_from"))
    return {
        "compared": verdict.compared(request, evidence.episodes),
        "answers": verdict.answers(request, evidence.paired, mean, evidence.baseline, evidence.guided),
        "exceptions": verdict.exceptions(evidence.paired, rule),
        "idle": verdict.idle_guidance(evidence.guidance),
        "is_visual": is_visual,
        "visual": visual,
        "precision": verdict.precision(artifacts),
        "reliable_rank": None if reliable_rank is None else f"{reliable_rank:g}",
        "counts_from": None if counts_from is None else f"{100 * counts_from:g}%",
        "replay": verdict.replay(pooled, request.tasks),
        "baseline": evidence.baseline,
    }


def _cards(request: ReportRequest, evidence: Evidence) -> list[dict[str, str]]:
    """Success of each variant over all tasks, for the head of the page."""
    mean = success.over_tasks(evidence.success, request.report.success)
    students = mean[mean["kind"] == "student"]
    shades = colours(request.variants())
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
    """All tables with at least one row."""
    rule = request.report.success
    pooled, mean = success.pooled(evidence.success, rule), success.over_tasks(evidence.success, rule)
    made = {
        "success": tables.success(pooled, mean, request.tasks, ["student"]),
        "conditions": tables.success(pooled, mean, request.tasks, ["condition"]),
        "controls": tables.success(pooled, mean, request.tasks, ["control"]),
        "rules": tables.rules(evidence.success),
        "paired": tables.differences(evidence.paired, rule),
        "images": tables.drops(evidence.images),
        "budget": tables.budget(evidence.budget, mean),
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
    """The configuration as yaml, and versions, machines and revisions from manifests and runs."""
    all_artifacts = [artifact for stage in artifacts.values() for artifact in stage]
    versions: dict[str, dict[str, None]] = {}
    for artifact in all_artifacts:
        for package, version in {**artifact.manifest.get("simulator", {}), **artifact.run.get("packages", {})}.items():
            versions.setdefault(package, {})[str(version)] = None
    machines = dict.fromkeys(text for artifact in all_artifacts if (text := _machine(artifact)))
    revisions = dict.fromkeys(artifact.run["revision"] for artifact in all_artifacts if artifact.run.get("revision"))
    return {
        "configuration": yaml.safe_dump(request.configuration, sort_keys=False, allow_unicode=True, width=120)
        if request.configuration
        else "",
        "versions": {package: ", ".join(each) for package, each in sorted(versions.items())},
        "machines": list(machines),
        "revisions": list(revisions),
    }


def _machine(artifact: Artifact) -> str:
    """Processor, cores, device and precision fallback of a run."""
    run = artifact.run
    cores = f"{run['cores']} cores" if run.get("cores") else ""
    device = "" if run.get("device") == "cpu" else run.get("device", "")
    fallback = "float32 for want of bfloat16" if artifact.precision == "float32" else ""
    return ", ".join(text for text in (run.get("processor", ""), cores, device, fallback) if text)
