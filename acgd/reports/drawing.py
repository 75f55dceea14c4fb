"""Draws the figures of a study: one for each kind of evidence that the study has."""

import pandas as pd
from matplotlib.figure import Figure

from acgd.reports import chain, curves, figures, numbers, success
from acgd.reports.artifact import Artifacts
from acgd.reports.evidence import Evidence
from acgd.reports.settings import ReportRequest
from acgd.reports.style import applied, svg


def draw(request: ReportRequest, evidence: Evidence, artifacts: Artifacts) -> dict[str, str]:
    """Figure name -> svg text."""
    with applied():
        return {name: svg(figure, name) for name, figure in _figures(request, evidence, artifacts).items()}


def _figures(request: ReportRequest, evidence: Evidence, artifacts: Artifacts) -> dict[str, Figure]:
    variants, rule, drawn = request.variants(), request.report.success, {}
    if len(evidence.success):
        drawn["success"] = figures.success(success.pooled(evidence.success, rule), request.tasks, variants)
    if len(evidence.paired):
        drawn["paired"] = figures.differences(evidence.paired, rule, variants, evidence.baseline)
    for name, stage, columns in (
        ("curves", "student", curves.STUDENT),
        ("codebook-curves", "codebook", curves.CODEBOOK),
    ):
        runs = curves.by_variant(request, stage, artifacts)
        if curves.logged(runs, columns):
            drawn[name] = figures.curves(runs, curves.logged(runs, columns), variants)
    runs, columns = curves.backbone(request, artifacts)
    if columns:
        drawn["backbone-curves"] = figures.curves(runs, columns, variants)
    critics = chain.labelled(request, "critic", artifacts)
    fits = {label: [artifact.curves()] for label, (_, artifact) in critics.items()}
    if curves.logged(fits, curves.CRITIC):
        drawn["critic-curves"] = figures.curves(fits, curves.logged(fits, curves.CRITIC), list(fits))
    experts = _expert_curves(request, artifacts)
    if experts:
        drawn["experts"] = figures.expert_curves(experts, rule)
    candidates = chain.candidates(request, artifacts)
    if candidates:
        ranks = {label: chain.ranks(frame) for label, frame in candidates.items()}
        reliable = numbers.common(evidence.guidance["reliable_rank"])
        drawn["critics"] = figures.within_state(ranks, evidence.critics, candidates, reliable)
    ratios = curves.ratios(request, artifacts)
    if ratios:
        floor = numbers.common(evidence.guidance["counts_from"])
        drawn["guidance"] = figures.ratios(ratios, request.tasks, variants, floor)
    return drawn


def _expert_curves(request: ReportRequest, artifacts: Artifacts) -> dict[str, pd.DataFrame]:
    cards = chain.labelled(request, "card", artifacts)
    frames = {label: artifact.csv("curve.csv") for label, (_, artifact) in cards.items()}
    return {label: frame for label, frame in frames.items() if len(frame) and request.report.success in frame}
