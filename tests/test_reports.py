"""The report: a row per variant, seed, task and rule; sentences that follow the numbers; one page without links."""

import json
import math
import re
from pathlib import Path
from types import SimpleNamespace
from xml.etree import ElementTree

import pandas as pd
import pytest
from study_artifacts import TASKS, study

from acgd.reports import numbers
from acgd.reports.artifact import load
from acgd.reports.evidence import Evidence
from acgd.reports.page import render
from acgd.reports.report import report as stage
from acgd.reports.settings import ReportConfig
from acgd.simulate.proportion import wilson
from acgd.store.metrics import Metrics

GUIDED = {"acgd": [0.88, 0.72, 0.8], "no-guidance": [0.84, 0.72, 0.8]}


def report(request, inputs, out: Path) -> tuple[Path, str]:
    out.mkdir()
    metrics = Metrics(out / "metrics.jsonl")
    stage(request, inputs, SimpleNamespace(out=out, metrics=metrics))
    metrics.flush()
    return out, (out / "report.html").read_text(encoding="utf-8")


def said(request, inputs) -> str:
    """The words of the page alone: drawing takes longer than all the rest."""
    artifacts = load(inputs)
    return words(render(request, Evidence.of(request, artifacts), {}, [], artifacts))


def words(page: str) -> str:
    """What a reader sees."""
    page = re.sub(r"<(style|svg).*?</\1>", " ", page, flags=re.DOTALL)
    page = re.sub(r"<[^>]*>", " ", page).replace("&amp;", "&")
    return re.sub(r"\s+", " ", page)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    root = tmp_path_factory.mktemp("study")
    return report(*study(root / "store", GUIDED, clips=True), root / "out")


def test_success_has_one_row_per_variant_seed_task_and_rule_with_its_interval(made) -> None:
    table = pd.read_csv(made[0] / "success.csv")
    assert not table.duplicated(["variant", "seed", "task", "rule"]).any()
    students = table[table["kind"] == "student"]
    assert set(students["variant"]) == set(GUIDED) and len(students) == 2 * 3 * 3 * 3
    row = students.query("variant == 'acgd' and seed == 1 and task == 'myo/obj-hold' and rule == 'final'").iloc[0]
    assert (row.episodes, row.successes) == (25, 18)
    expected = wilson(18, 25)
    assert (row.rate, row.low, row.high) == pytest.approx((0.72, expected.low, expected.high), abs=1e-6)


def test_conditions_that_a_student_without_goal_cannot_tell_apart_count_once(tmp_path: Path) -> None:
    request, inputs = study(tmp_path, {"acgd": [0.6]}, seeds=(0,), shuffled=None)
    episodes = inputs["evaluation"][0] / "episodes.jsonl"
    episodes.write_text(2 * episodes.read_text())
    evidence = Evidence.of(request, load(inputs))
    assert evidence.success.query("kind == 'student'")["episodes"].tolist() == [25, 25, 25]


def test_controls_are_rows_of_the_same_table(made) -> None:
    table = pd.read_csv(made[0] / "success.csv")
    controls = set(table.loc[table["kind"] == "control", "variant"])
    replays = {
        "control: open-loop replay",
        "control: nearest-start replay",
        "control: expert",
        "control: expert, nominal start",
    }
    assert controls == replays | {"control: acgd, shuffled images", "control: no-guidance, shuffled images"}
    assert (table.loc[table["variant"] == "control: expert, nominal start", "episodes"] == 1).all()


def test_paired_differences_are_those_of_the_episodes(made) -> None:
    table = pd.read_csv(made[0] / "paired.csv").query("rule == 'final'").set_index("task")
    assert list(table.index) == [*TASKS, "all tasks"]
    assert table.loc["myo/key-turn", "mean"] == pytest.approx(0.04)
    assert (table.loc["myo/key-turn", ["wins", "losses", "pairs"]] == [3, 0, 75]).all()
    assert table.loc["all tasks", "mean"] == pytest.approx(0.04 / 3, abs=1e-6)
    nothing = table.loc["myo/reach"]
    assert nothing["mean"] == 0 and nothing["high"] == -nothing["low"] > 0


def test_the_page_is_one_file_that_asks_for_nothing(made) -> None:
    page = made[1]
    assert not re.findall(r"""(?:src|href|url)\s*[=(]\s*["']?(?!data:|#)[^"'\s>]""", page.replace("xmlns", ""))
    assert "http://" not in page and "https://" not in page
    assert page.count("data:video/mp4;base64,") == 3
    assert "var(--ink)" in page and "<script" not in page


def test_ids_of_the_figures_do_not_collide(made) -> None:
    ids = re.findall(r'\bid="([^"]+)"', made[1])
    assert len(ids) == len(set(ids))
    assert set(re.findall(r'(?:href="#|url\(#)([^")]+)', made[1])) <= set(ids)


def test_figures_are_files_too_and_well_formed(made) -> None:
    names = {path.stem for path in made[0].glob("*.svg")}
    assert names == {
        "success",
        "paired",
        "curves",
        "codebook-curves",
        "backbone-curves",
        "experts",
        "critics",
        "critic-curves",
        "guidance",
    }
    for path in made[0].glob("*.svg"):
        ElementTree.parse(path)
        assert "<dc:date>" not in path.read_text()


def test_the_same_artifacts_give_the_same_bytes(made, tmp_path: Path) -> None:
    again, _ = report(*study(tmp_path / "store", GUIDED, clips=True), tmp_path / "out")
    files = sorted(path.name for path in made[0].iterdir())
    assert files == sorted(path.name for path in again.iterdir())
    for name in files:
        assert (made[0] / name).read_bytes() == (again / name).read_bytes(), name


@pytest.mark.parametrize(
    ("acgd", "verdict"),
    [(0.6, "Guidance is not shown to help"), (0.96, "Guidance helped"), (0.2, "Guidance hurt")],
)
def test_the_headline_follows_the_interval(tmp_path: Path, acgd: float, verdict: str) -> None:
    text = said(*study(tmp_path, {"acgd": [acgd] * 2, "no-guidance": [0.6] * 2}, seeds=(0, 1, 2, 3, 4)))
    assert verdict in text and "carry an interval" not in text
    assert ("an interval that covers zero" in text) == (verdict == "Guidance is not shown to help")
    assert f"acgd {acgd:.2f}, no-guidance 0.60" in text


def test_fewer_than_five_student_seeds_carry_an_interval_and_no_claim(tmp_path: Path) -> None:
    text = said(*study(tmp_path, {"acgd": [0.96] * 2, "no-guidance": [0.2] * 2}, seeds=(0, 1, 2)))
    assert "Three student seeds do not tell whether guidance helps: acgd 0.96, no-guidance 0.20" in text
    assert "Three student seeds carry an interval and no claim; a claim needs five student seeds." in text
    assert "Guidance helped" not in text and "Task by task" not in text


def test_variants_that_do_not_differ_in_guidance_are_not_judged_by_it(tmp_path: Path) -> None:
    text = said(*study(tmp_path, {"small": [0.2] * 2, "large": [0.8] * 2}, guided=(), seeds=(0, 1, 2, 3, 4)))
    assert "large did better than small: large 0.80, small 0.20" in text and "Guidance" not in text
    assert "By chance, one of twenty such intervals does; here are 2." in text


def test_one_student_seed_is_called_one(tmp_path: Path) -> None:
    text = said(*study(tmp_path, {"acgd": [0.9] * 2, "no-guidance": [0.3] * 2}, seeds=(7,)))
    assert "The interval is of the episodes only; nothing is known of the next student seed." in text
    assert "One student seed does not tell whether guidance helps" in text


def test_a_task_that_replay_solves_is_named(tmp_path: Path) -> None:
    text = said(*study(tmp_path, {"acgd": [0.36, 0.9], "no-guidance": [0.36, 0.9]}))
    assert "as well as the best student on myo/key-turn (nearest-start replay 0.40, best student 0.36): there" in text
    assert "reads nothing after the start" in text and "blind" not in text and "never looks" not in text


def test_the_lines_of_gate_and_floor_are_those_of_the_students(tmp_path: Path) -> None:
    rates = {"acgd": [0.6], "no-guidance": [0.6]}
    with_gate = said(*study(tmp_path / "with", rates, reliable_rank=0.35))
    assert "A ratio below 1% counts as no guidance." in with_gate
    request, inputs = study(tmp_path / "drawn", rates, reliable_rank=0.35)
    page = words(report(request, inputs, tmp_path / "out")[1])
    assert "Dashed: 0.35, the least low end of the interval for the reliable gate" in page
    request, inputs = study(tmp_path / "without", rates)
    assert "reliable gate" not in words(report(request, inputs, tmp_path / "out2")[1])


def test_stages_come_in_the_order_of_the_chain(tmp_path: Path) -> None:
    request, inputs = study(tmp_path / "store", {"acgd": [0.6], "no-guidance": [0.6]}, rounds=1, clips=True)
    stages = list(load(inputs))
    assert list(inputs) == sorted(stages)
    chain = ["expert", "rollouts", "backbone", "features", "student", "onpolicy"]
    assert [stage for stage in stages if stage in chain] == chain
    assert stages.index("critic") < stages.index("quality") and stages.index("evaluation") < stages.index("clips")


def test_the_budget_of_a_variant_counts_its_rounds_and_its_own_chain(tmp_path: Path) -> None:
    request, inputs = study(tmp_path / "store", {"acgd": [0.6, 0.6], "no-guidance": [0.6, 0.6]}, rounds=2)
    artifacts = load(inputs)
    evidence = Evidence.of(request, artifacts)
    budget = evidence.budget.set_index(["variant", "seed"])
    assert (budget["demonstration_steps"] == 600).all()
    assert (budget["on_policy_steps"] == 2 * 2 * 500).all() and (budget["on_policy_queries"] == 2 * 2 * 400).all()
    stages = {stage: [artifact.run["cpu_s"] for artifact in made] for stage, made in artifacts.items()}
    upstream = ("expert", "rollouts", "backbone", "features")
    shared = sum(sum(stages[stage]) for stage in upstream) + stages["codebook"][0]
    students, rounds = sum(stages["student"][:3]), sum(stages["onpolicy"][:4])
    assert budget.loc[("acgd", 0), "cpu_s"] == pytest.approx(shared + sum(stages["critic"]) + students + rounds)
    assert "Cost of a student" in said(request, inputs) and "expert queries, on-policy" in said(request, inputs)
    assert set(evidence.stages.query("stage == 'onpolicy' and variants == 'acgd'")["name"].head(2)) == {
        "myo/key-turn, seed 0, round 1",
        "myo/obj-hold, seed 0, round 1",
    }


def test_a_comparison_that_mixes_precisions_says_so(tmp_path: Path) -> None:
    request, inputs = study(tmp_path, {"acgd": [0.6], "no-guidance": [0.6]})
    assert "mixes precisions" not in said(request, inputs)
    run = inputs["student"][0] / "run.json"
    run.write_text(json.dumps(json.loads(run.read_text()) | {"precision_used": "float32"}))
    text = said(request, inputs)
    assert "The study mixes precisions: of artifacts that ask for bfloat16, student (1 of 6 in float32)" in text
    assert "float32 for want of bfloat16" in text


@pytest.mark.parametrize(
    ("kept", "verdict"), [(0.1, "The study is visual"), (0.9, "The study is not visual"), (None, "was not measured")]
)
def test_the_page_says_whether_the_study_is_visual(tmp_path: Path, kept: float | None, verdict: str) -> None:
    assert verdict in said(*study(tmp_path, {"acgd": [0.8], "no-guidance": [0.8]}, shuffled=kept, seeds=(0,)))


def test_faint_guidance_is_called_none(made) -> None:
    faint = "the critics’ gradient stayed below 1% of imitation’s for myo/reach (acgd, 3 students)"
    assert f"{faint}, which counts as no guidance" in words(made[1])


def test_numbers_carry_their_interval_and_counts(made) -> None:
    low, high = wilson(66, 75).low, wilson(66, 75).high
    assert f"0.88 [{low:.2f}, {high:.2f}] (66/75)" in words(made[1])


@pytest.mark.parametrize(
    "less",
    [
        {"features": False, "seeds": (4,)},
        {"guided": (), "seeds": (0,), "features": False, "controls": False, "shuffled": None},
    ],
)
def test_a_study_without_optional_stages_has_a_report(tmp_path: Path, less: dict) -> None:
    request, inputs = study(tmp_path / "store", {"one": [0.6, 0.4], "two": [0.5, 0.4]}, **{"guided": ("one",), **less})
    out, page = report(request, inputs, tmp_path / "out")
    assert (out / "success.csv").stat().st_size > 100 and "nan" not in words(page).lower()


def test_a_study_of_one_variant_and_task(tmp_path: Path) -> None:
    out, page = report(*study(tmp_path / "store", {"acgd": [0.6]}, seeds=(0,)), tmp_path / "out")
    assert "nothing to compare" in words(page) and not (out / "paired.csv").exists()


def test_variants_are_compared_on_common_seeds_alone(tmp_path: Path) -> None:
    request, inputs = study(tmp_path / "store", {"acgd": [0.6], "no-guidance": [0.6]})
    entries = tuple(
        entry
        for entry in request.entries
        if (entry.variant, entry.seed) not in {("acgd", 0), ("no-guidance", 1), ("no-guidance", 2)}
    )
    assert "acgd shares no student seed, start and task with no-guidance" in said(
        request.model_copy(update={"entries": entries}), inputs
    )


def test_an_unknown_baseline_is_refused_with_the_known_ones(tmp_path: Path) -> None:
    request, inputs = study(
        tmp_path / "store", {"acgd": [0.6], "no-guidance": [0.6]}, config=ReportConfig(baseline="nothing")
    )
    with pytest.raises(ValueError, match="'nothing'.*choose one of acgd, no-guidance"):
        said(request, inputs)


def test_an_artifact_that_variants_share_is_paid_once(made) -> None:
    stages = pd.read_csv(made[0] / "stages.csv")
    assert len(stages) == stages["key"].nunique()
    codebook = stages[stages["stage"] == "codebook"]
    assert len(codebook) == 3 and set(codebook["variants"]) == {"acgd, no-guidance"}
    assert set(stages.loc[stages["stage"] == "critic", "variants"]) == {"acgd"}


@pytest.mark.parametrize(
    ("written", "expected"),
    [
        (numbers.proportion(0.84, 0.74, 0.906, 63, 75), "0.84 [0.74, 0.91] (63/75)"),
        (numbers.proportion(0.84, math.nan, math.nan), "0.84"),
        (numbers.difference(0.04, -0.02, 0.1), "+0.04 [−0.02, +0.10]"),
        (numbers.signed(-0.001), "0.00"),
        (numbers.duration(4.24), "4.2 s"),
        (numbers.duration(185), "3:05 min"),
        (numbers.duration(7260), "2:01 h"),
        (numbers.size(1_530_000), "2 MB"),
        (numbers.figure(2_000_000), "2 000 000"),
        (numbers.listing(["a", "b", "c"]), "a, b and c"),
    ],
)
def test_how_numbers_are_written(written: str, expected: str) -> None:
    assert written == expected
