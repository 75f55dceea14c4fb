"""All tables of a report, from the artifacts of a study."""

from dataclasses import dataclass

import pandas as pd

from acgd.reports import chain, curves, differences, ledger, success, verdict
from acgd.reports.artifact import Artifacts
from acgd.reports.settings import ReportRequest

TABLES = (
    "episodes", "success", "paired", "images", "budget", "experts", "demonstrations", "critics", "guidance", "backbone",
    "codebook", "stages", "curves",
)  # fmt: skip
"""Tables that are written as csv files of the same name."""


@dataclass(frozen=True)
class Evidence:
    """The tables of the report, and the choice of the baseline."""

    baseline: str
    guided: frozenset[str]
    """Variants that are trained with guidance."""
    episodes: pd.DataFrame
    success: pd.DataFrame
    paired: pd.DataFrame
    images: pd.DataFrame
    """Loss of success without the image, per variant, by the headline rule."""
    budget: pd.DataFrame
    experts: pd.DataFrame
    demonstrations: pd.DataFrame
    critics: pd.DataFrame
    guidance: pd.DataFrame
    backbone: pd.DataFrame
    codebook: pd.DataFrame
    stages: pd.DataFrame
    curves: pd.DataFrame

    @classmethod
    def of(cls, request: ReportRequest, artifacts: Artifacts) -> "Evidence":
        """Makes all tables from the artifacts."""
        guided, rule = chain.guided_variants(request, artifacts), request.report.success
        baseline, episodes = verdict.choose_baseline(request, guided), success.gather(request, artifacts)
        return cls(
            baseline=baseline,
            guided=guided,
            episodes=episodes,
            success=success.table(episodes),
            paired=differences.paired(episodes, baseline, request.tasks),
            images=differences.without_image(episodes, rule, request.tasks),
            budget=ledger.budget(request, artifacts),
            experts=chain.experts(request, artifacts),
            demonstrations=chain.demonstrations(request, artifacts),
            critics=chain.critics(request, artifacts),
            guidance=chain.gates(request, artifacts),
            backbone=chain.backbones(request, artifacts),
            codebook=chain.codebooks(request, artifacts),
            stages=ledger.cost(request, artifacts),
            curves=curves.table(curves.by_variant(request, "student", artifacts)),
        )

    def csv(self) -> dict[str, str]:
        """File name -> content. Tables without a row are left out, except success.csv."""
        frames = {name: getattr(self, name) for name in TABLES}
        return {
            f"{name}.csv": frame.to_csv(index=False, float_format="%.6g", lineterminator="\n")
            for name, frame in frames.items()
            if len(frame) or name == "success"
        }
