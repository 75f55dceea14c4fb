"""The bench table: times and memory from run.json, one failing benchmark does not hide the others."""

import json
from importlib import import_module
from pathlib import Path

import pytest
import yaml

from acgd.store.store import Store
from acgd.study.plan import plan
from acgd.study.study import load_study
from benchmarks import study, table
from benchmarks.study import Job, busy_seconds, peak_bytes


@pytest.mark.parametrize("name", table.BENCHMARKS)
def test_every_benchmark_can_be_run(name: str) -> None:
    assert callable(import_module(f"benchmarks.{name}").run)


def job(started: float, seconds: float, gigabytes: int = 1) -> Job:
    return Job("student", started, seconds, gigabytes, resumed=False)


def test_wall_time_counts_overlaps_once_and_leaves_out_the_night() -> None:
    assert busy_seconds([job(0, 10), job(2, 3), job(5, 10)]) == 15
    assert busy_seconds([job(0, 10), job(14, 6)]) == 20, "the workflow's own seconds between two stages count"
    assert busy_seconds([job(0, 10), job(40_000, 5)]) == 15


def test_memory_is_that_of_stages_at_once() -> None:
    assert peak_bytes([job(0, 10, 2), job(5, 10, 3), job(15, 5, 4)]) == 5


def test_a_finished_study_is_measured_and_one_more_variant_runs_only_its_own_stages(tmp_path: Path) -> None:
    content = {
        "name": "toy",
        "expert": {"kind": "ppo"},
        "seeds": [0, 1],
        "variants": {"acgd": {}, "plain": {"guidance": {"kind": "none"}}},
    }
    config = tmp_path / "config.yaml"
    config.write_text(yaml.safe_dump(content))
    store = Store(tmp_path / "results")
    artifacts = plan(load_study(content)).artifacts
    for i, place in enumerate(artifacts):
        folder = store.path(place)
        folder.mkdir(parents=True)
        (folder / "run.json").write_text(
            json.dumps({"started": 1e9 + 10 * i, "wall_s": 8.0, "peak_rss_bytes": 10**9, "resumed": False})
        )
        (folder / "manifest.json").write_text("{}")
    rows = {row["name"]: row for row in study.run(config, store.results)}
    assert rows["study/wall time"]["value"] == pytest.approx((10 * len(artifacts) - 2) / 60)
    assert rows["study/wall time"]["met"] and rows["study/peak memory of stages at once"]["value"] == 1
    assert rows["study/student x 4"]["value"] == 32
    assert rows["study/jobs of one more variant"]["value"] == 6 and rows["study/jobs of one more variant"]["met"]


def test_an_unfinished_study_says_what_to_do(tmp_path: Path) -> None:
    (tmp_path / "config.yaml").write_text(yaml.safe_dump({"name": "toy", "expert": {"kind": "ppo"}}))
    with pytest.raises(study.NotMeasured, match="make demo"):
        study.run(tmp_path / "config.yaml", tmp_path / "results")


def test_one_failing_benchmark_does_not_hide_the_others(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def measured(name: str) -> list[dict]:
        if name == "broken":
            raise RuntimeError("no GL")
        return [
            {"name": f"{name}/rate", "value": 1234.5, "unit": "frames/s", "ratio": 61.0, "target": ">= 60", "met": True}
        ]

    monkeypatch.setattr(table, "BENCHMARKS", ("broken", "working"))
    monkeypatch.setattr(table, "RESULT", tmp_path / "bench.json")
    monkeypatch.setattr(table, "_measured", measured)
    assert table.main([]) == 1
    out = capsys.readouterr().out
    assert "broken: not measured. RuntimeError: no GL" in out and "working/rate" in out
    expected = {"working/rate": {"value": 1234.5, "unit": "frames/s", "ratio": 61.0, "target": ">= 60", "met": True}}
    assert json.loads((tmp_path / "bench.json").read_text()) == expected
    assert table.main(["misspelt"]) == 1
