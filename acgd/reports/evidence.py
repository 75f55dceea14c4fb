"""All tables of a report, from the artifacts of a study."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import pandas as pd

from acgd.reports import chain, curves, differences, ledger, success, verdict
from acgd.reports.artifact import Artifact
from acgd.reports.settings import ReportRequest

Artifacts = Mapping[str, Sequence[Artifact]]
"""Stage name -> its artifacts, in the order that the request's entries count in."""


@dataclass(frozen=True)
class Evidence:
    """The figures behind the page; each table is one csv file of the same name."""

    baseline: str
    episodes: pd.DataFrame
    success: pd.DataFrame
    paired: pd.DataFrame
    images: pd.DataFrame
    """What each variant loses without its image, under the headline rule."""
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
        baseline, rule = verdict.choose_baseline(request), request.report.success
        episodes = success.gather(request, artifacts["evaluation"], artifacts["controls"])
        return cls(
            baseline=baseline,
            episodes=episodes,
            success=success.table(episodes),
            paired=differences.paired(episodes, baseline, request.tasks),
            images=differences.without_image(episodes, rule, request.tasks),
            experts=chain.experts(request, artifacts["expert"]),
            demonstrations=chain.demonstrations(request, artifacts["rollouts"]),
            critics=chain.critics(request, artifacts["critic"]),
            guidance=chain.gates(request, artifacts["student"]),
            backbone=chain.backbones(request, artifacts["backbone"]),
            codebook=chain.codebooks(request, artifacts["codebook"]),
            stages=ledger.cost(request, artifacts),
            curves=curves.table(curves.by_variant(request, "student", artifacts["student"])),
        )

    def csv(self) -> dict[str, str]:
        """File name -> content; tables without a row are left out, but for success.csv."""
        names = (
            "episodes",
            "success",
            "paired",
            "images",
            "experts",
            "demonstrations",
            "critics",
            "guidance",
            "backbone",
            "codebook",
            "stages",
            "curves",
        )
        frames = {name: getattr(self, name) for name in names}
        return {
            f"{name}.csv": frame.to_csv(index=False, float_format="%.6g", lineterminator="\n")
            for name, frame in frames.items()
            if len(frame) or name == "success"
        }
