"""What is wrong with a configuration is said in one line: the key, the nearest name, the mend. Nothing runs."""

import json
from pathlib import Path

import pytest

from acgd.study import reference
from acgd.study.load import ConfigError, merge, read_yaml
from acgd.study.study import Study, load_study
from acgd.study.variants import expanded

ROOT = Path(__file__).parents[1]
TRAINED = {"expert": {"kind": "ppo"}}

MALFORMED = [
    pytest.param({"studnet": {}}, ["studnet", "Nearest: student"], id="unknown section"),
    pytest.param({"guidance": {"alfa": 1}}, ["guidance.alfa", "Nearest: alpha", "Rename"], id="unknown key"),
    pytest.param({"training": {"lr": 1}}, ["training.lr", "Nearest: learning_rate"], id="abbreviation"),
    pytest.param({"training": {"chunk": 8}}, ["training.chunk", "student.chunk", "Move it there"], id="other section"),
    pytest.param(
        {"expert": {"random_steps": 8}},
        ["expert.random_steps", "kind sac", "Set expert.kind"],
        id="key of another kind",
    ),
    pytest.param(
        {"guidance": {"kind": "critics"}}, ["guidance.kind", "'critics'", "Nearest: critic"], id="no such kind"
    ),
    pytest.param(
        {"imitation": {"label": "means"}}, ["imitation.label", "'means'", "Nearest: mean"], id="no such choice"
    ),
    pytest.param({"student": 3}, ["student: should be a map", "3"], id="section is no map"),
    pytest.param({"training": 3}, ["training: should be a map", "3"], id="section without kinds is no map"),
    pytest.param(
        {"rollouts": {"demonstrations": "many"}},
        ["rollouts.demonstrations", "whole number", "'many'", "default, 50"],
        id="wrong type",
    ),
    pytest.param(
        {"expert": {"width": "wide"}}, ["expert.width: should be a whole number", "'wide'"], id="wrong type in a kind"
    ),
    pytest.param(
        {"rollouts": {"demonstrations": 0}},
        ["rollouts.demonstrations", "greater than or equal to 1", "not 0"],
        id="out of range",
    ),
    pytest.param({"guidance": {"alpha": float("nan")}}, ["guidance.alpha", "nan"], id="not a number"),
    pytest.param(
        {"tasks": ["myo/reech"]}, ["tasks", "'myo/reech' is no task", "Nearest: myo/reach"], id="impossible task"
    ),
    pytest.param({"tasks": []}, ["tasks", "at least 1"], id="no task"),
    pytest.param({"tasks": "myo/reach"}, ["tasks: should be a list", "'myo/reach'"], id="task is no list"),
    pytest.param({"tasks": ["myo/reach"] * 2}, ["tasks", "twice"], id="task twice"),
    pytest.param(
        {"tasks": ["myo/reach", "opdex/spray-1"]},
        ["tasks", "opdex/spray-1", "different robots", "study for each suite"],
        id="two suites",
    ),
    pytest.param(
        {"tasks": ["opdex/spray-1"]}, ["critic.action_space", "motors", "Set it to raw"], id="muscles of a robot"
    ),
    pytest.param({"seeds": [0, 0]}, ["seeds", "twice"], id="seed twice"),
    pytest.param({"seeds": [-1]}, ["seeds", "-1", "seeds from 0 on"], id="negative seed"),
    pytest.param({"backbone": {"kind": "r3m"}}, ["backbone", "path"], id="weights not named"),
    pytest.param(
        {"backbone": {"kind": "r3m", "path": "no/model.pt"}}, ["backbone.path", "no/model.pt"], id="missing file"
    ),
    pytest.param(
        {"imitation": {"frames": 2}, "backbone": {"kind": "scratch"}},
        ["imitation.frames", "scratch", "Set it to 1"],
        id="earlier frames for a student's own CNN",
    ),
    pytest.param(
        {"tasks": ["myo/key-turn"], "imitation": {"goal": "vector"}},
        ["imitation.goal", "no task of the study", "Set it to any"],
        id="no goal to command",
    ),
    pytest.param(
        {"conditions": [{"goal": "commanded"}]},
        ["conditions", "commanded", "imitation.goal: any", "training or oracle"],
        id="a goal that the student cannot read",
    ),
    pytest.param({"conditions": [{"goal": "x"}]}, ["conditions[0].goal", "oracle"], id="inside a list"),
    pytest.param(
        {"overrides": {"myo/reech": {}}},
        ["overrides.myo/reech", "not in tasks", "Nearest: myo/reach"],
        id="override of no task",
    ),
    pytest.param(
        {"overrides": {"myo/reach": {"expert": {"stepz": 1}}}},
        ["overrides.myo/reach.expert.stepz", "Nearest: steps"],
        id="override",
    ),
    pytest.param(
        {"overrides": {"myo/reach": {"student": {}}}},
        ["overrides.myo/reach.student", "unknown key"],
        id="override of a shared stage",
    ),
    pytest.param(
        {"variants": {"a": {"guidance": {"alfa": 1}}}}, ["variants.a.guidance.alfa", "Nearest: alpha"], id="variant"
    ),
    pytest.param(
        {"variants": {"a": {"student": {"width": 30}}}}, ["variants.a.student", "no multiple of heads"], id="merged"
    ),
    pytest.param(
        {"variants": {"a": {"student": {"kind": "bc", "chunk": 3}}}},
        ["variants.a.student.chunk", "kind acgd"],
        id="variant of another kind",
    ),
    pytest.param(
        {"variants": {"a": {"overrides": {"myo/reach": {"critic": {"stepz": 1}}}}}},
        ["variants.a", "myo/reach.critic.stepz", "Nearest: steps"],
        id="variant's override",
    ),
    pytest.param(
        {"variants": {"a": {"backbone": {"kind": "r3m", "path": "no.pt"}}}},
        ["variants.a", "backbone.path", "no.pt"],
        id="variant's file",
    ),
    pytest.param(
        {"variants": {"a": {"tasks": ["myo/pose"]}}}, ["variants.a.tasks", "another study"], id="variant of tasks"
    ),
    pytest.param(
        {"variants": {"a": {"guidance": {"alpha": {"expand": 3}}}}},
        ["variants", "guidance.alpha", "expand: [first, second"],
        id="expand over no list",
    ),
    pytest.param({"variants": {"a/b": {}}}, ["variants", "'a/b' cannot name a folder"], id="name of a variant"),
    pytest.param({"name": "store"}, ["name", "'store'", "none of"], id="name of the study"),
    pytest.param(
        {"variants": {"acgd": {}}, "report": {"baseline": "agcd"}}, ["report.baseline", "Nearest: acgd"], id="baseline"
    ),
]


@pytest.mark.parametrize("content, said", MALFORMED)
def test_malformed_configuration_is_refused_with_its_mend(content, said):
    with pytest.raises(ConfigError) as caught:
        load_study(merge(TRAINED, content))
    for part in said:
        assert part in str(caught.value)


def test_every_fault_has_its_line():
    with pytest.raises(ConfigError) as caught:
        load_study({"studnet": {}, "critic": {"members": "x"}})
    assert len(str(caught.value).splitlines()) == 2


def test_without_a_zoo_expert_the_tasks_that_have_one_are_named(tmp_path, monkeypatch):
    monkeypatch.setattr("acgd.experts.zoo.ROOT", tmp_path)
    stocked = tmp_path / "myo-pose"
    stocked.mkdir()
    for name in ("policy.safetensors", "policy.json", "card.json", "curve.csv"):
        (stocked / name).write_bytes(b"x")
    with pytest.raises(ConfigError, match="expert.kind: zoo/ has no expert for myo/reach.*expert.kind.*myo/pose"):
        load_study({"tasks": ["myo/reach"]})
    load_study({"tasks": ["myo/pose"]})


@pytest.mark.parametrize(
    "content, said",
    [
        (
            {"tasks": ["myo/key-turn-hard"], "expert": {"kind": "ppo"}, "critic": {"kind": "zoo"}},
            "critic.kind.*key-turn-hard trains one.*fqe",
        ),
        (
            {"tasks": ["myo/key-turn"], "critic": {"kind": "expert"}},
            "critic.kind: the expert in zoo/ for myo/key-turn.*fqe.*myo/obj-hold-hard",
        ),
        (
            {"tasks": ["myo/key-turn"], "expert": {"kind": "ppo"}, "critic": {"kind": "expert"}},
            "critic.kind: the expert that is trained for myo/key-turn.*sac",
        ),
        (
            {"tasks": ["myo/reach"], "expert": {"kind": "ppo", "warm_start": "myo/flip"}},
            "expert.warm_start: .* myo/flip.*myo/reach",
        ),
    ],
)
def test_experts_and_critics_that_do_not_go_together(content, said):
    with pytest.raises(ConfigError, match=said):
        load_study(content)
    load_study({"tasks": ["myo/obj-hold-hard"], "critic": {"kind": "expert"}})
    load_study({"tasks": ["myo/reach-hard"], "expert": {"kind": "ppo", "warm_start": "myo/reach"}})


def test_without_a_zoo_critic_the_tasks_that_have_one_are_named(tmp_path, monkeypatch):
    monkeypatch.setattr("acgd.experts.zoo.has_fitted_critic", lambda task: task == "myo/pose")
    with pytest.raises(ConfigError, match="critic.kind: zoo/ has no critic for myo/reach. .*fqe.*it has: myo/pose"):
        load_study({"tasks": ["myo/reach"], "critic": {"kind": "zoo"}})
    load_study({"tasks": ["myo/pose"], "critic": {"kind": "zoo"}})


@pytest.mark.parametrize("text, said", [("a: [", "not readable"), ("- 1", "a list"), ("", "nothing")])
def test_unreadable_file(tmp_path, text, said):
    file = tmp_path / "study.yaml"
    file.write_text(text)
    with pytest.raises(ConfigError, match=said):
        read_yaml(file)


def test_missing_file_names_the_nearest(tmp_path):
    (tmp_path / "table2.yaml").touch()
    with pytest.raises(ConfigError, match="table2.yaml"):
        read_yaml(tmp_path / "tabel2.yaml")


def test_strings_of_the_command_line_become_numbers():
    """snakemake --config 'training={steps: 7}' gives the text '7'."""
    content = {**TRAINED, "training": {"steps": "7", "learning_rate": "1e-3"}, "report": {"clips": "false"}}
    study = load_study(content)
    assert (study.training.steps, study.training.learning_rate, study.report.clips) == (7, 1e-3, False)


def test_a_study_cannot_be_changed():
    study = load_study(TRAINED)
    with pytest.raises(ValueError, match="frozen"):
        study.name = "other"


def test_variants_merge_maps_replace_lists_and_keep_the_base():
    base = {**TRAINED, "guidance": {"alpha": 2.0}, "critic": {"perturbation": {"scales": [0.1, 0.2]}}}
    a = {"guidance": {"gate": "reliable"}, "critic": {"perturbation": {"scales": [0.3]}}}
    study = load_study({**base, "variants": {"a": a, "b": {}}})
    a, b = study.resolved["a"], study.resolved["b"]
    assert (a.guidance.alpha, a.guidance.gate, a.critic.perturbation.scales) == (2.0, "reliable", (0.3,))
    assert (b.guidance.gate, b.critic.perturbation.scales) == ("one", (0.1, 0.2))


def test_a_variant_of_another_kind_starts_from_the_defaults_of_that_kind():
    base = {**TRAINED, "student": {"width": 64}, "training": {"steps": 7}, "overrides": {"myo/reach": {}}}
    variants = {"bc": {"student": {"kind": "bc"}}, "same": {"student": {"kind": "acgd", "chunk": 2}}}
    study = load_study({**base, "variants": variants})
    bc, same = study.resolved["bc"], study.resolved["same"]
    assert bc.student == type(bc.student)() and bc.training.steps == 7
    assert (same.student.width, same.student.chunk) == (64, 2)


def test_a_task_of_another_kind_starts_from_the_defaults_of_that_kind():
    content = {"expert": {"kind": "ppo", "width": 64, "steps": 3}, "tasks": ["myo/reach", "myo/pose"]}
    study = load_study({**content, "overrides": {"myo/pose": {"expert": {"kind": "sac"}}}})
    reach, pose = study.resolved["base"].each_task
    assert (reach.expert.kind, reach.expert.width, pose.expert) == ("ppo", 64, type(pose.expert)())


def test_one_task_can_differ_from_the_others():
    study = load_study(
        {
            **TRAINED,
            "tasks": ["myo/reach", "myo/pose"],
            "overrides": {"myo/pose": {"critic": {"members": 5}, "task": {"start": "nominal"}}},
        }
    )
    reach, pose = study.resolved["base"].each_task
    assert (reach.critic.members, pose.critic.members, reach.task.start, pose.task.start) == (
        2,
        5,
        "perturbed",
        "nominal",
    )


def test_expand_gives_every_combination_by_name():
    variants = expanded({"a": {"x": {"y": {"expand": [1, "two"]}, "z": {"expand": [0.5, None]}}}, "b": {}})
    assert list(variants) == ["a-y-1-z-0.5", "a-y-1-z-null", "a-y-two-z-0.5", "a-y-two-z-null", "b"]
    assert variants["a-y-two-z-0.5"] == {"x": {"y": "two", "z": 0.5}}


def test_a_study_survives_the_way_to_json_and_back():
    """Jobs get the configuration as JSON."""
    content = {**TRAINED, "seeds": [3], "variants": {"a": {"guidance": {"alpha": {"expand": [1, 2]}}}}}
    assert load_study(json.loads(json.dumps(content))) == load_study(content)


def test_the_studies_that_are_shipped_are_valid():
    for file in [ROOT / "config.yaml", *sorted((ROOT / "studies").glob("*.yaml"))]:
        load_study(read_yaml(file))


@pytest.mark.parametrize(
    "name, text", [("configuration.md", reference.markdown()), ("schema.json", reference.schema())]
)
def test_the_reference_is_that_of_the_models(name, text):
    assert (ROOT / "docs" / name).read_text() == text, "the models have changed; type: python -m acgd schema"


def test_every_field_is_described():
    lacking = [line for line in reference.markdown().splitlines() if line.startswith("| `") and line.endswith("|  |")]
    assert not lacking


def test_the_schema_is_of_the_whole_study():
    assert set(json.loads(reference.schema())["properties"]) == set(Study.model_fields)
