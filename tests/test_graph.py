"""Keys: what changes one, and what must not. An edit remakes what depends on it, and nothing else."""

import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

from acgd import chain
from acgd.experts import zoo
from acgd.store import key
from acgd.study.load import merge
from acgd.study.plan import plan
from acgd.study.study import load_study
from acgd.tasks import definition

ROOT = Path(__file__).parents[1]
BASE = {
    "name": "t",
    "tasks": ["myo/reach", "myo/pose"],
    "seeds": [0, 1],
    "expert": {"kind": "ppo"},
    "conditions": [{"goal": "training"}, {"goal": "training", "image_features": "shuffled"}],
    "variants": {"acgd": {"guidance": {"kind": "critic"}}, "no-guidance": {"guidance": {"kind": "none"}}},
}
COUNTS = dict(
    expert=2,
    card=2,
    critic=2,
    quality=2,
    rollouts=2,
    backbone=1,
    features=2,
    codebook=2,
    student=4,
    evaluation=8,
    clips=4,
    controls=1,
    report=1,
)
OF_STUDENTS = {"student", "evaluation", "clips", "report"}
OF_CODEBOOKS = OF_STUDENTS | {"codebook"}
SEEING = OF_CODEBOOKS | {"backbone", "features", "rollouts", "controls"}
ALL = set(COUNTS)


def planned(edit=None):
    return plan(load_study(merge(BASE, edit or {})))


def counted(planned):
    stages = [artifact.stage.name for artifact in planned.artifacts.values()]
    return {stage: stages.count(stage) for stage in dict.fromkeys(stages)}


def remade(edit):
    """Stages of which an edit makes new artifacts, and of which it makes all of them anew."""
    return difference(planned(), planned(edit))


def difference(before, after):
    new = [artifact.stage.name for place, artifact in after.artifacts.items() if place not in before.artifacts]
    kept = {artifact.stage.name for place, artifact in after.artifacts.items() if place in before.artifacts}
    return set(new), set(new) - kept


def test_variants_share_all_that_they_agree_on():
    assert counted(planned()) == COUNTS


def test_upstream_comes_first():
    seen = set()
    for place, artifact in planned({"variants": {"rounds": {"rounds": {"count": 2}}}}).artifacts.items():
        assert all(one.place in seen for one in artifact.upstream)
        seen.add(place)


def test_a_stage_names_exactly_what_it_uses():
    names = planned().names
    guided, unguided = names["acgd/seed-0/student"][0], names["no-guidance/seed-0/student"][0]
    assert set(guided.inputs) - set(unguided.inputs) == {"critic"}
    assert "no-guidance/critic" not in names and "no-guidance/quality" not in names
    assert guided.inputs["codebook"] is unguided.inputs["codebook"]
    assert names["acgd/backbone"][0].key in str(guided.inputs["codebook"].inputs["features"][0].input_keys)
    evaluation = names["acgd/seed-0/evaluation"][0]
    assert set(evaluation.inputs) == {"student", "backbone", "rollouts"}


def test_a_student_without_codes_has_no_codebook():
    names = planned({"variants": {"bc": {"student": {"kind": "bc"}}}}).names
    assert "bc/codebook" not in names
    assert set(names["bc/seed-0/student"][0].inputs) == {"rollouts", "backbone", "features", "critic"}


def test_a_gate_reads_the_quality_of_the_critics_and_nothing_else_does():
    names = planned({"variants": {"gated": {"guidance": {"gate": "reliable"}}}}).names
    assert (
        "quality" in names["gated/seed-0/student"][0].inputs and "quality" not in names["acgd/seed-0/student"][0].inputs
    )


@pytest.mark.parametrize(
    "edit, stages",
    [
        ({"training": {"learning_rate": 3e-4}}, OF_STUDENTS),
        ({"evaluation": {"episodes": 50}}, {"evaluation", "clips", "report"}),
        ({"acting": {"eta": 1.0}}, {"evaluation", "clips", "report"}),
        ({"report": {"clips": False}}, {"report"}),
        ({"controls": {"episodes": 50}}, {"controls", "report"}),
        ({"card": {"episodes": 50}}, {"card", "report"}),
        ({"quality": {"states": 8}}, {"quality", "report"}),
        ({"student": {"codes": 8}}, OF_CODEBOOKS),
        ({"student": {"codebook": {"code_weight": 0.2}}}, OF_CODEBOOKS),
        ({"features": {"precision": "bfloat16"}}, OF_CODEBOOKS | {"features"}),
        ({"backbone": {"dim": 32}}, OF_CODEBOOKS | {"backbone", "features"}),
        ({"rollouts": {"demonstrations": 10}}, SEEING),
        ({"image": {"size": 64}}, SEEING - {"controls"} | {"controls"}),
        ({"expert": {"seed": 1}}, ALL),
        ({"task": {"start": "nominal"}}, ALL),
    ],
    ids=str,
)
def test_an_edit_remakes_its_stage_and_what_follows(edit, stages):
    assert remade(edit) == (stages, stages)


@pytest.mark.parametrize(
    "edit", [{"guidance": {"alpha": 3}}, {"guidance": {"guided_steps": "first"}}, {"critic": {"width": 64}}], ids=str
)
def test_settings_of_guidance_touch_only_guided_students(edit):
    stages, whole = remade(edit)
    assert stages <= OF_STUDENTS | {"critic", "quality"} and whole <= {"critic", "quality", "report"}
    assert "codebook" not in stages and "student" not in whole


def test_one_task_alone_is_remade():
    stages, whole = remade({"overrides": {"myo/pose": {"critic": {"width": 64}}}})
    assert stages == OF_STUDENTS | {"critic", "quality"} and whole == {"report"}


def test_a_new_variant_makes_only_its_own():
    stages, whole = remade({"variants": {"gated": {"guidance": {"gate": "reliable"}}}})
    assert stages == OF_STUDENTS and whole == {"report"}


def test_a_new_condition_makes_only_its_own_evaluations():
    edit = {"conditions": [*BASE["conditions"], {"goal": "oracle"}]}
    assert remade(edit) == ({"evaluation", "report"}, {"report"})


def test_a_new_seed_makes_only_its_own():
    stages, whole = remade({"seeds": [0, 1, 2]})
    assert stages == OF_CODEBOOKS and whole == {"report"}


ROUNDS = {"variants": {"dagger": {"guidance": {"kind": "none"}, "rounds": {"count": 2}}}}


def test_rounds_add_rollouts_and_students_and_leave_round_0_alone():
    before, after = planned(), planned(ROUNDS)
    new = [artifact for place, artifact in after.artifacts.items() if place not in before.artifacts]
    counts = {stage: sum(one.stage.name == stage for one in new) for stage in chain.names()}
    expected = dict(onpolicy=8, onpolicy_features=8, student=4, evaluation=4, clips=2, report=1)
    assert {stage: count for stage, count in counts.items() if count} == expected
    names = after.names
    assert names["dagger/seed-0/round-0/student"][0] is names["no-guidance/seed-0/student"][0]
    assert names["dagger/seed-0/student"] == names["dagger/seed-0/round-2/student"]
    last = names["dagger/seed-0/student"][0]
    assert last.inputs["student"] is names["dagger/seed-0/round-1/student"][0]
    tasks = ["myo-reach", "myo-pose"]
    wanted = [names[f"dagger/seed-0/round-{number}/{task}/onpolicy"][0] for number in (1, 2) for task in tasks]
    assert list(last.inputs["onpolicy"]) == wanted
    assert wanted[0].inputs["student"] is names["no-guidance/seed-0/student"][0]
    assert names["dagger/seed-0/evaluation"][0].inputs["student"] is last


def test_another_round_keeps_the_rounds_before():
    more = merge(ROUNDS, {"variants": {"dagger": {"rounds": {"count": 3}}}})
    stages, whole = difference(planned(ROUNDS), planned(more))
    assert stages == OF_STUDENTS | {"onpolicy", "onpolicy_features"} and "student" not in whole


def test_steps_of_a_round_collect_no_episode_of_that_round_anew():
    once = merge(ROUNDS, {"variants": {"dagger": {"rounds": {"count": 1}}}})
    more = merge(once, {"variants": {"dagger": {"rounds": {"steps": 7}}}})
    assert difference(planned(once), planned(more))[0] == OF_STUDENTS


@pytest.mark.parametrize("kind", ["bc", "bc_rnn"])
def test_ways_of_acting_do_not_tell_students_of_one_action_apart(kind):
    single = {"variants": {"acgd": {"student": {"kind": kind}}, "no-guidance": {"student": {"kind": kind}}}}
    assert difference(planned(single), planned(merge(single, {"acting": {"eta": 1.0}})))[0] == {"report"}


@pytest.mark.parametrize(("goal", "shown"), [("off", "none"), ("vector", "commanded")])
def test_goal_conditions_are_one_for_students_without_goal_images(goal, shown):
    blind = {"imitation": {"goal": goal}}
    both = {**blind, "conditions": [{"goal": "training"}, {"goal": "oracle"}]}
    one = {**blind, "conditions": [{"goal": "training"}]}
    assert set(planned(both).artifacts) - set(planned(one).artifacts) == {planned(both).report.place}
    assert planned(both).names["acgd/seed-0/evaluation"][0].request.condition.goal == shown


@pytest.mark.parametrize(
    "edit",
    [
        {"device": "cpu"},
        {"training": {"checkpoint_every": 7}},
        {"critic": {"checkpoint_every": 7}},
        {"expert": {"checkpoint_every": 7}},
        {"backbone": {"checkpoint_every": 7}},
        {"variants": {"acgd": {"guidance": {"alpha": 10.0}}}},
    ],
    ids=str,
)
def test_device_cadence_and_defaults_change_no_artifact(edit):
    """The report prints the configuration, so it may be made anew."""
    assert remade(edit)[0] <= {"report"}


def test_device_and_cadence_do_not_even_change_the_report():
    assert remade({"device": "cpu", "critic": {"checkpoint_every": 7}}) == (set(), set())


def test_the_order_of_configuration_keys_changes_no_artifact():
    shuffled = {name: BASE[name] for name in reversed(BASE)}
    assert list(plan(load_study(shuffled)).artifacts) == list(planned().artifacts)


def test_stage_version_is_in_the_key(monkeypatch):
    before = planned()
    row = chain.STAGES["codebook"]
    monkeypatch.setitem(chain.STAGES, "codebook", type(row)(**{**vars(row), "version": 99}))
    assert difference(before, planned())[0] == OF_CODEBOOKS


def _task_edit(monkeypatch, part, task="myo/pose"):
    real = definition.definition

    def edited(name):
        digests = real(name)
        changed = {"episode": digests.episode, "picture": digests.picture}
        if name == task:
            changed[part] = "edited"
        return SimpleNamespace(**changed)

    monkeypatch.setattr(definition, "definition", edited)


def test_an_edit_of_a_task_remakes_all_of_that_task_and_no_other(monkeypatch):
    before = planned()
    _task_edit(monkeypatch, "episode")
    after = planned()
    stages, whole = difference(before, after)
    assert stages == ALL and whole == ALL - {"expert", "card", "critic", "quality", "rollouts", "features"} | {
        "features"
    }
    for stage in ("expert", "card", "critic", "quality", "rollouts"):
        names = [f"acgd/{task}/{stage}" for task in ("myo-reach", "myo-pose")]
        assert [before.names[name][0].key == after.names[name][0].key for name in names] == [True, False]


def test_an_edit_of_a_camera_remakes_no_expert_and_no_critic(monkeypatch):
    before = planned()
    _task_edit(monkeypatch, "picture")
    stages, _ = difference(before, planned())
    assert stages == SEEING


def test_simulator_version_is_in_every_key(monkeypatch):
    before = set(planned().artifacts)
    monkeypatch.setattr(definition, "packages", lambda task: {"mujoco": "0"})
    assert not before & set(planned().artifacts)


def test_drawing_packages_are_in_the_keys_of_pictures(monkeypatch):
    before = planned()
    monkeypatch.setattr(definition, "drawing_packages", lambda: {"fast-simplification": "0"})
    assert difference(before, planned())[0] == SEEING


def _stock(root, task, content=b"weights"):
    folder = root / task.replace("/", "-")
    folder.mkdir(parents=True, exist_ok=True)
    for name in ("policy.safetensors", "policy.json", "card.json", "curve.csv"):
        (folder / name).write_bytes(content)
    return folder


def test_a_zoo_file_is_in_the_key_of_all_that_follows_from_it(tmp_path, monkeypatch):
    monkeypatch.setattr(zoo, "ROOT", tmp_path)
    edit = {"expert": {"kind": "zoo"}}
    for task in BASE["tasks"]:
        _stock(tmp_path, task)
    before = planned(edit)
    _stock(tmp_path, "myo/pose", b"others")
    after = planned(edit)
    for name in ("acgd/myo-reach/expert", "acgd/myo-reach/critic", "acgd/myo-reach/rollouts"):
        assert after.names[name][0].key == before.names[name][0].key
    for stage in ("myo-pose/expert", "myo-pose/critic", "backbone", "student", "controls"):
        assert after.names[f"acgd/{stage}"][0].key != before.names[f"acgd/{stage}"][0].key


def test_a_zoo_card_and_curve_remake_the_card_alone(tmp_path, monkeypatch):
    monkeypatch.setattr(zoo, "ROOT", tmp_path)
    edit = {"expert": {"kind": "zoo"}}
    for task in BASE["tasks"]:
        _stock(tmp_path, task)
    before = planned(edit)
    for name in ("card.json", "curve.csv"):
        (tmp_path / "myo-pose" / name).write_bytes(b"rewritten")
    assert difference(before, planned(edit))[0] == {"card", "report"}


def test_a_file_counts_by_its_content_wherever_it_lies(tmp_path):
    def backbone(path):
        return planned({"backbone": {"kind": "r3m", "path": str(path)}}).names["acgd/backbone"][0].key

    here, there = tmp_path / "model.pt", tmp_path / "other.pt"
    here.write_bytes(b"\x80weights")
    there.write_bytes(b"\x80weights")
    same = backbone(here)
    assert backbone(there) == same
    there.write_bytes(b"\x80changed")
    assert backbone(there) != same


def test_a_learned_backbone_belongs_to_no_task():
    scratch = planned({"backbone": {"kind": "scratch"}})
    assert not scratch.names["acgd/backbone"][0].inputs and "acgd/features" not in scratch.names
    assert "features" not in scratch.names["acgd/seed-0/student"][0].inputs


def test_names_are_guessable_and_lead_to_the_artifacts():
    names = planned().names
    assert len(names["acgd/student"]) == 2 and len(names["acgd/rollouts"]) == 2
    assert names["acgd/student"][1] is names["acgd/seed-1/student"][0]
    assert names["acgd/rollouts"][0] is names["acgd/myo-reach/rollouts"][0]
    assert len(names["acgd/seed-0/evaluation"]) == 2


def test_the_report_finds_its_inputs_by_place():
    report = planned().report
    entries = {(entry.variant, entry.seed): entry for entry in report.request.entries}
    assert len(entries) == 4
    names = planned().names
    for (variant, seed), entry in entries.items():
        (student,) = entry.artifacts["student"]
        assert report.inputs["student"][student].key == names[f"{variant}/seed-{seed}/student"][0].key
        critics = [report.inputs["critic"][place].name for place in entry.artifacts.get("critic", ())]
        assert critics == (["myo-reach", "myo-pose"] if variant == "acgd" else [])
        conditions = [report.inputs["evaluation"][place].request.condition for place in entry.artifacts["evaluation"]]
        assert [condition.image_features for condition in conditions] == ["own", "shuffled"]


def test_canonical_json_refuses_what_has_no_equal():
    assert key.canonical({"b": 1, "a": [1.0, "é"]}) == '{"a":[1.0,"é"],"b":1}'
    with pytest.raises(ValueError, match="JSON"):
        key.canonical(float("nan"))


def test_planning_imports_no_simulator_and_no_network_library():
    code = (
        "import sys; from acgd.study.plan import plan; from acgd.study.study import load_study;"
        "plan(load_study({'expert': {'kind': 'ppo'}})); import acgd.study.commands, acgd.__main__;"
        "print(*{'torch', 'mlflow', 'mujoco', 'gymnasium', 'numpy', 'pandas', 'scipy'} & set(sys.modules))"
    )
    run = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert run.stdout.split() == []
