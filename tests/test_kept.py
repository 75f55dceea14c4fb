"""Kept results: kept without weights, restored into an empty store, read by the report only."""

import json
from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace

import pytest
from study_artifacts import study

from acgd.reports.report import report
from acgd.store.metrics import Metrics
from acgd.store.store import ArtifactError, Store, check, damages
from acgd.study import commands, kept

REVISED = {"acgd": [0.6], "no-guidance": [0.8]}


@dataclass
class InventedPlan:
    """The parts of a plan that keeping reads."""

    study: str
    artifacts: dict[str, SimpleNamespace]
    report: SimpleNamespace
    inputs: dict[str, list[str]] = field(default_factory=dict)
    """Stage -> places, as the report reads them."""


def published(store: Store, invented: Path) -> str:
    """Publishes an invented artifact, with a weight beside its small files; its place."""
    manifest = json.loads((invented / "manifest.json").read_text())
    place = f"{manifest['stage']}/{manifest['name']}/{manifest['key']}"

    def fill(space) -> dict:
        for file in invented.rglob("*"):
            if file.is_file() and file.name not in ("manifest.json", "run.json"):
                target = space.payload / file.relative_to(invented)
                target.parent.mkdir(parents=True, exist_ok=True)
                target.write_bytes(file.read_bytes())
        (space.payload / "weights.safetensors").write_bytes(b"w" * 1000)
        return json.loads((invented / "run.json").read_text())

    identity = {name: manifest[name] for name in ("request", "inputs", "simulator")}
    store.make(place, identity, fill)
    return place


@pytest.fixture
def invented(tmp_path: Path):
    """A store with a finished study, its plan, and the request of its report."""
    request, inputs = study(tmp_path / "invented", REVISED, seeds=(0, 1), rounds=1, clips=True)
    store = Store(tmp_path / "results")
    places = {stage: [published(store, path) for path in paths] for stage, paths in inputs.items()}
    about = SimpleNamespace(place="report/demo/0")
    artifacts = {place: SimpleNamespace(place=place) for each in places.values() for place in each}
    return store, InventedPlan("demo", artifacts | {about.place: about}, about, places), request


def page(store: Store, plan: InventedPlan, request, out: Path) -> dict[str, bytes]:
    """The tables of the report over a store."""
    out.mkdir()
    inputs = {stage: [store.path(place) for place in places] for stage, places in plan.inputs.items()}
    for paths in inputs.values():
        for path in paths:
            check(path, restored=True)
    with Metrics(out / "metrics.jsonl") as metrics:
        report(request, inputs, SimpleNamespace(out=out, metrics=metrics))
    return {file.name: file.read_bytes() for file in out.glob("*.csv")}


def test_a_restored_study_gives_the_same_tables(invented, tmp_path: Path) -> None:
    store, plan, request = invented
    kept_in = tmp_path / "docs"
    outcome = kept.keep(store, plan, kept_in)
    assert len(outcome.done) == len(plan.artifacts) - 1 and not outcome.missing and not outcome.too_large
    files = [file for file in kept_in.rglob("*") if file.is_file()]
    assert {file.suffix for file in files} <= {".json", ".jsonl", ".csv"}
    assert not [file for file in files if ".zarr" in str(file)]

    empty = Store(tmp_path / "empty")
    restored = kept.restore(empty, plan, kept_in)
    assert restored.done == outcome.done and not restored.missing
    before, after = page(store, plan, request, tmp_path / "before"), page(empty, plan, request, tmp_path / "after")
    assert before == after and len(before) > 8
    again = kept.restore(empty, plan, kept_in)
    assert not again.done and again.present == restored.done


def test_a_restored_artifact_is_whole_for_verify_and_refused_to_other_stages(invented, tmp_path: Path, capsys) -> None:
    store, plan, _ = invented
    kept.keep(store, plan, tmp_path / "docs")
    empty = Store(tmp_path / "empty")
    kept.restore(empty, plan, tmp_path / "docs")
    commands.verify(empty, repair=False)
    assert "0 damaged" in capsys.readouterr().out
    student = empty.path(plan.inputs["student"][0])
    check(student, restored=True)
    with pytest.raises(ArtifactError, match=r"lacks 1 of its files, such as weights.safetensors.*restore --discard"):
        check(student)
    (student / "student.json").write_text("{}")
    assert damages(student, empty.manifest(plan.inputs["student"][0])["payload"])

    kept.discard(empty)
    assert empty.places() == []
    kept.discard(store)
    assert len(store.places()) == len(plan.artifacts) - 1


def test_unfinished_artifacts_and_artifacts_that_are_not_kept_are_listed(invented, tmp_path: Path) -> None:
    store, plan, _ = invented
    lost = plan.inputs["evaluation"][0]
    store.remove(lost)
    assert kept.keep(store, plan, tmp_path / "docs").missing == [lost]
    assert kept.restore(Store(tmp_path / "empty"), plan, tmp_path / "docs").missing == [lost]
    with pytest.raises(ArtifactError, match="no results are kept there.*acgd keep"):
        kept.restore(store, plan, tmp_path / "elsewhere")


def test_changed_kept_files_are_refused(invented, tmp_path: Path) -> None:
    store, plan, _ = invented
    kept.keep(store, plan, tmp_path / "docs")
    place = plan.inputs["evaluation"][0]
    file = tmp_path / "docs" / place / "episodes.jsonl"
    file.write_text(file.read_text().replace("true", "false"))
    empty = Store(tmp_path / "empty")
    with pytest.raises(ArtifactError, match="episodes.jsonl has .*git checkout"):
        kept.restore(empty, plan, tmp_path / "docs")
    assert not empty.has(place)


def test_large_files_and_other_keys_are_left_out(invented, tmp_path: Path, monkeypatch) -> None:
    store, plan, _ = invented
    docs = tmp_path / "docs"
    kept.keep(store, plan, docs)
    gone = plan.inputs["student"][-1]
    plan.artifacts.pop(gone)
    monkeypatch.setattr(kept, "LIMIT", 3000)
    outcome = kept.keep(store, plan, docs)
    assert not (docs / gone).exists()
    curves = f"{plan.inputs['student'][0]}/metrics.jsonl"
    assert curves in outcome.too_large and not (docs / curves).exists()
    assert (docs / plan.inputs["evaluation"][0] / "episodes.jsonl").is_file()
