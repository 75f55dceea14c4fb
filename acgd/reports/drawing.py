"""Which figures a study gets: one for each kind of evidence that it has."""

from collections.abc import Sequence

import pandas as pd
from matplotlib.figure import Figure

from acgd.reports import chain, curves, figures, success
from acgd.reports.artifact import Artifact
from acgd.reports.evidence import Artifacts, Evidence
from acgd.reports.settings import ReportRequest
from acgd.reports.style import applied, svg

GATE = 0.2
"""The rank correlation that the `reliable` gate asks for, as a line to read the critics by (StudentConfig.reliable_rank)."""
COUNTS = 0.01
"""Ratio of gradient norms below which guidance counts as none, as the student stage has it."""


def draw(request: ReportRequest, evidence: Evidence, artifacts: Artifacts) -> dict[str, str]:
    """Figure name -> svg text."""
    with applied():
        return {name: svg(figure, name) for name, figure in _figures(request, evidence, artifacts).items()}


def _figures(request: ReportRequest, evidence: Evidence, artifacts: Artifacts) -> dict[str, Figure]:
    variants, rule, drawn = list(dict.fromkeys(entry.variant for entry in request.entries)), request.report.success, {}
    if len(evidence.success):
        drawn["success"] = figures.success(success.pooled(evidence.success, rule), request.tasks, variants)
    if len(evidence.paired):
        drawn["paired"] = figures.differences(evidence.paired, rule, variants, evidence.baseline)
    for name, stage, columns in (
        ("curves", "student", curves.STUDENT),
        ("codebook-curves", "codebook", curves.CODEBOOK),
    ):
        runs = curves.by_variant(request, stage, artifacts[stage])
        if curves.logged(runs, columns):
            drawn[name] = figures.curves(runs, curves.logged(runs, columns), variants)
    runs, chosen = curves.backbone(request, artifacts["backbone"])
    if chosen:
        drawn["backbone-curves"] = figures.curves(runs, chosen, variants)
    found = chain.used(request, "critic", artifacts["critic"])
    fits = {label: [artifact.curves()] for (_, _, artifact), label in zip(found, chain.labels(found), strict=True)}
    if curves.logged(fits, curves.CRITIC):
        drawn["critic-curves"] = figures.curves(fits, curves.logged(fits, curves.CRITIC), list(fits))
    experts = _expert_curves(request, artifacts["expert"])
    if experts:
        drawn["experts"] = figures.expert_curves(experts, rule)
    candidates = chain.candidates(request, artifacts["critic"])
    if candidates:
        ranks = {label: chain.ranks(frame) for label, frame in candidates.items()}
        drawn["critics"] = figures.within_state(ranks, evidence.critics, candidates, GATE)
    ratios = curves.ratios(request, artifacts["student"])
    if ratios:
        drawn["guidance"] = figures.ratios(ratios, request.tasks, variants, COUNTS)
    return drawn


def _expert_curves(request: ReportRequest, artifacts: Sequence[Artifact]) -> dict[str, pd.DataFrame]:
    found = chain.used(request, "expert", artifacts)
    frames = {
        label: artifact.csv("curve.csv") for (_, _, artifact), label in zip(found, chain.labels(found), strict=True)
    }
    return {label: frame for label, frame in frames.items() if len(frame) and request.report.success in frame}
