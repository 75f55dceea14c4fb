"""The stage `report`: the results of a study on one page, with tables and figures as files."""

from acgd.reports import media, success
from acgd.reports.artifact import load
from acgd.reports.drawing import draw
from acgd.reports.evidence import Evidence
from acgd.reports.page import render
from acgd.reports.settings import ReportRequest
from acgd.store.stage import Context, Inputs


def report(request: ReportRequest, inputs: Inputs, ctx: Context) -> None:
    """Writes report.html, *.csv and *.svg. Equal artifacts with equal run.json give equal bytes."""
    artifacts = load(inputs)
    evidence = Evidence.of(request, artifacts)
    svgs = draw(request, evidence, artifacts)
    page = render(request, evidence, svgs, media.films(request, artifacts), artifacts)
    files = evidence.csv() | {f"{name}.svg": text for name, text in svgs.items()} | {"report.html": page}
    for name, text in files.items():
        (ctx.out / name).write_text(text, encoding="utf-8")
    ctx.metrics.rewind(-1)
    mean = success.over_tasks(evidence.success, request.report.success)
    ctx.metrics.log(0, **{f"success/{row.variant}": row.rate for row in mean.itertuples() if row.kind == "student"})
