"""Keys: what changes one, and what must not. An edit remakes what depends on it, and nothing else."""

import subprocess
import sys
from pathlib import Path

import pytest

from acgd.experts import zoo
from acgd.store import key, versions
from acgd.study.load import merge
from acgd.study.plan import plan
from acgd.study.study import load_study

ROOT = Path(__file__).parents[1]
BASE = {
    "name": "t",
    "tasks": ["myo/reach", "myo/pose"],
    "seeds": [0, 1],
    "expert": {"source": "train"},
    "variants": {"acgd": {"student": {"guidance": "critic"}}, "no-guidance": {"student": {"guidance": "none"}}},
}
ALL = set(versions.STAGES)


def planned(edit=None):
    return plan(load_study(merge(BASE, edit or {})))


def remade(edit):
    """Stages of which an edit makes new artifacts, and of which it makes all of them anew."""
    before, after = planned(), planned(edit)
    new = [artifact.stage for place, artifact in after.artifacts.items() if place not in before.artifacts]
    kept = {artifact.stage for place, artifact in after.artifacts.items() if place in before.artifacts}
    return set(new), set(new) - kept


def test_variants_share_all_that_they_agree_on():
    stages = [artifact.stage for artifact in planned().artifacts.values()]
    counts = {stage: stages.count(stage) for stage in versions.STAGES}
    assert counts == dict(
        expert=2,
        critic=2,
        rollouts=2,
        backbone=1,
        features=2,
        codebook=2,
        student=4,
        evaluation=4,
        controls=1,
        report=1,
    )


def test_upstream_comes_first():
    seen = set()
    for place, artifact in planned().artifacts.items():
        assert all(one.place in seen for one in artifact.upstream)
        seen.add(place)


def test_a_stage_names_exactly_what_it_uses():
    names = planned().names
    guided, unguided = names["acgd/seed-0/student"][0], names["no-guidance/seed-0/student"][0]
    assert set(guided.inputs) - set(unguided.inputs) == {"critics"}
    assert "no-guidance/critic" not in names
    assert guided.inputs["codebook"] is unguided.inputs["codebook"]
    assert names["acgd/backbone"][0].key in str(guided.inputs["codebook"].inputs["features"][0].input_keys)


@pytest.mark.parametrize(
    "edit, stages",
    [
        ({"student": {"training": {"learning_rate": 3e-4}}}, {"student", "evaluation", "report"}),
        ({"evaluation": {"episodes": 50}}, {"evaluation", "report"}),
        ({"report": {"clips": False}}, {"report"}),
        ({"controls": {"episodes": 50}}, {"controls", "report"}),
        ({"codebook": {"codes": 8}}, {"codebook", "student", "evaluation", "report"}),
        ({"features": {"precision": "bfloat16"}}, {"features", "codebook", "student", "evaluation", "report"}),
        ({"backbone": {"dim": 32}}, {"backbone", "features", "codebook", "student", "evaluation", "report"}),
        ({"rollouts": {"demonstrations": 10}}, ALL - {"expert", "critic"}),
        ({"expert": {"seed": 1}}, ALL),
        ({"task": {"image_size": 64}}, ALL),
    ],
    ids=str,
)
def test_an_edit_remakes_its_stage_and_what_follows(edit, stages):
    assert remade(edit) == (stages, stages)


def test_critics_touch_only_guided_students():
    stages, whole = remade({"critic": {"width": 64}})
    assert stages == {"critic", "student", "evaluation", "report"} and whole == {"critic", "report"}


def test_one_task_alone_is_remade():
    stages, whole = remade({"overrides": {"myo/pose": {"critic": {"width": 64}}}})
    assert stages == {"critic", "student", "evaluation", "report"} and whole == {"report"}


def test_a_new_variant_makes_only_its_own():
    stages, whole = remade({"variants": {"gated": {"student": {"gate": "reliable"}}}})
    assert stages == {"student", "evaluation", "report"} and whole == {"report"}


def test_a_new_seed_makes_only_its_own():
    stages, whole = remade({"seeds": [0, 1, 2]})
    assert stages == {"codebook", "student", "evaluation", "report"} and whole == {"report"}


@pytest.mark.parametrize(
    "edit",
    [
        {"device": "cpu"},
        {"student": {"training": {"log_every": 7, "checkpoint_every": 7}}},
        {"critic": {"checkpoint_every": 7}},
        {"expert": {"checkpoint_every": 7}},
        {"backbone": {"checkpoint_every": 7}},
        {"variants": {"acgd": {"student": {"alpha": 10.0}}}},
        {"backbone": {"size": 100}},
    ],
    ids=str,
)
def test_device_cadence_defaults_and_unread_fields_change_no_artifact(edit):
    """The report prints the configuration, so it may be made anew."""
    assert remade(edit)[0] <= {"report"}


def test_device_and_cadence_do_not_even_change_the_report():
    assert remade({"device": "cpu", "critic": {"checkpoint_every": 7}}) == (set(), set())


def test_order_of_keys_is_nothing():
    shuffled = {name: BASE[name] for name in reversed(BASE)}
    assert list(plan(load_study(shuffled)).artifacts) == list(planned().artifacts)


def test_stage_version_is_in_the_key(monkeypatch):
    before = planned()
    monkeypatch.setitem(versions.STAGES, "codebook", 99)
    new = {artifact.stage for place, artifact in planned().artifacts.items() if place not in before.artifacts}
    assert new == {"codebook", "student", "evaluation", "report"}


def test_simulator_version_is_in_every_key(monkeypatch):
    before = set(planned().artifacts)
    monkeypatch.setattr(versions, "simulator", lambda: {"mujoco": "0"})
    assert not before & set(planned().artifacts)


def _stock(root, task, content=b"weights"):
    folder = root / task.replace("/", "-")
    folder.mkdir(parents=True, exist_ok=True)
    for name in zoo.FILES:
        (folder / name).write_bytes(content)
    return folder


def test_a_zoo_file_is_in_the_key_of_all_that_follows_from_it(tmp_path, monkeypatch):
    monkeypatch.setattr(zoo, "ROOT", tmp_path)
    edit = {"expert": {"source": "zoo"}}
    for task in BASE["tasks"]:
        _stock(tmp_path, task)
    before = planned(edit)
    assert {
        artifact.stage
        for place, artifact in planned({"expert": {"source": "zoo", "ppo": {"steps": 7}}}).artifacts.items()
        if place not in before.artifacts
    } <= {"report"}
    _stock(tmp_path, "myo/pose", b"others")
    after = planned(edit)
    for name in ("acgd/myo-reach/expert", "acgd/myo-reach/critic", "acgd/myo-reach/rollouts"):
        assert after.names[name][0].key == before.names[name][0].key
    for name in (
        "acgd/myo-pose/expert",
        "acgd/myo-pose/critic",
        "acgd/backbone",
        "no-guidance/student",
        "no-guidance/controls",
    ):
        assert after.names[name][0].key != before.names[name][0].key


def test_a_file_counts_by_its_content_wherever_it_lies(tmp_path):
    def backbone(path):
        return planned({"backbone": {"kind": "r3m", "path": str(path)}}).names["acgd/backbone"][0].key

    here, there = tmp_path / "model.pt", tmp_path / "other.pt"
    here.write_bytes(b"weights")
    there.write_bytes(b"weights")
    same = backbone(here)
    assert backbone(there) == same
    there.write_bytes(b"changed")
    assert backbone(there) != same


def test_a_learned_or_pretrained_backbone_belongs_to_no_task():
    scratch = planned({"backbone": {"kind": "scratch"}})
    assert not scratch.names["acgd/backbone"][0].inputs and "acgd/features" not in scratch.names
    assert "features" not in scratch.names["acgd/seed-0/student"][0].inputs


def test_names_are_guessable_and_lead_to_the_artifacts():
    names = planned().names
    assert len(names["acgd/student"]) == 2 and len(names["acgd/rollouts"]) == 2
    assert names["acgd/student"][1] is names["acgd/seed-1/student"][0]
    assert names["acgd/rollouts"][0] is names["acgd/myo-reach/rollouts"][0]


def test_the_report_finds_its_inputs_by_place():
    report = planned().report
    entries = {(entry.variant, entry.seed): entry for entry in report.request.entries}
    assert len(entries) == 4
    names = planned().names
    for (variant, seed), entry in entries.items():
        assert report.inputs["student"][entry.student].key == names[f"{variant}/seed-{seed}/student"][0].key
        assert [report.inputs["critic"][place].name for place in entry.critic] == (
            ["myo-reach", "myo-pose"] if variant == "acgd" else []
        )


def test_canonical_json_refuses_what_has_no_equal():
    assert key.canonical({"b": 1, "a": [1.0, "é"]}) == '{"a":[1.0,"é"],"b":1}'
    with pytest.raises(ValueError, match="JSON"):
        key.canonical(float("nan"))


def test_planning_imports_no_simulator_and_no_network_library():
    code = (
        "import sys; from acgd.study.plan import plan; from acgd.study.study import load_study;"
        "plan(load_study({'expert': {'source': 'train'}})); import acgd.study.commands, acgd.__main__;"
        "print(*{'torch', 'mlflow', 'mujoco', 'gymnasium', 'numpy', 'pandas'} & set(sys.modules))"
    )
    run = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert run.stdout.split() == []
