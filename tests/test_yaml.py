"""YAML as people write it: accepted, or refused with the line and the mend."""

from pathlib import Path

import pytest

from acgd.study.load import ConfigError, read_study, read_yaml
from acgd.study.study import load_study

TRAINED = "expert: {kind: ppo}\ntasks: [myo/reach]\n"


def loaded(folder, text):
    file = folder / "study.yaml"
    file.write_text(text)
    return load_study(read_yaml(file))


@pytest.mark.parametrize(
    "text, of, value",
    [
        ("imitation: {goal: off}", lambda s: s.imitation.goal, "off"),
        ("report: {clips: no}", lambda s: s.report.clips, False),
        ("report: {clips: true}", lambda s: s.report.clips, True),
        ("training: {steps: 1e6}", lambda s: s.training.steps, 1_000_000),
        ("training: {steps: 1_000}", lambda s: s.training.steps, 1000),
        ("training: {learning_rate: 1e-3}", lambda s: s.training.learning_rate, 1e-3),
        ("training: {learning_rate: .5}", lambda s: s.training.learning_rate, 0.5),
        ("seeds: [010, 7]", lambda s: s.seeds, (10, 7)),
        ("name: 2026-11-28", lambda s: s.name, "2026-11-28"),
        ("name: off", lambda s: s.name, "off"),
        ("name: '10'", lambda s: s.name, "10"),
        ("variants: {no: {}, yes: {}, 10: {}, 1e3: {}}", lambda s: [*s.resolved], ["no", "yes", "10", "1e3"]),
        (
            "variants: {goal: {imitation: {goal: {expand: [own, any, off]}}}}",
            lambda s: [*s.resolved],
            ["goal-goal-own", "goal-goal-any", "goal-goal-off"],
        ),
        ("report: {baseline: no}\nvariants: {no: {}}", lambda s: s.report.baseline, "no"),
        ("training: &t {steps: 7}\nvariants: {a: {training: {<<: *t, batch: 3}}}", lambda s: s.training.steps, 7),
    ],
)
def test_what_is_written_is_meant(tmp_path, text, of, value):
    assert of(loaded(tmp_path, TRAINED + text)) == value


@pytest.mark.parametrize(
    "text, said",
    [
        ("seeds: [0]\nseeds: [1]", ["study.yaml, line 4: seeds is there twice, first in line 3", "remove one"]),
        ("variants:\n  a: {}\n  a: {}", ["line 5: variants.a is there twice, first in line 4"]),
        ("seeds:\n  - 1\n  - 99999999999999999999", ["line 5: seeds[1]: 99999999999999999999 has more than 64 bits"]),
        ("guidance:\n  kind: critic\n  alfa: 3", ["line 5: guidance.alfa: unknown key", "Nearest: alpha"]),
        ("variants:\n  a:\n    guidance: {alfa: 3}", ["line 5: variants.a.guidance.alfa: unknown key"]),
        ("variants:\n  a:\n    backbone: {kind: r3m, path: no.pt}", ["line 5: variants.a"]),
        ("backbone: {kind: r3m}", ["line 3: backbone: no path is set"]),
        ("name: 10", ["line 3: name: should be a text, not 10", "quotes: '10'"]),
        ("name: store", ["line 3: name: 'store' cannot name a folder"]),
        ("name: mlflow.db", ["line 3: name: 'mlflow.db' may be the name of a file", "Leave out the ending .db"]),
        ("variants: {success.csv: {}}", ["'success.csv' may be the name of a file"]),
        ("variants: {A: {}, a: {}}", ["'A' and 'a' are one folder on some disks"]),
        ("variants: {'~': {}}", ["'~' cannot name a folder"]),
        (f"variants: {{{'x' * 200}: {{}}}}", ["has 200 characters. Use at most 120"]),
        ("variants: {a: {training: {batch: {expand: [8, 8]}}}}", ["'a-batch-8'", "distinct", "training.batch: [8, 8]"]),
        ("training:\n\tsteps: 3", ["line 4", "\\t", "Indent with spaces"]),
        ("seeds: [0", ["line", "not readable"]),
        ("seeds: &a [*a]", ["line 3", "contains itself"]),
        ("name: !!python/name:os.system ''", ["line 3", "tag", "Remove it"]),
        ("? [1]\n: 2", ["line 3", "a key must be a text"]),
        ("backbone: {kind: huggingface, path: ~/no-such-model}", [str(Path.home() / "no-such-model"), "config.json"]),
    ],
)
def test_what_cannot_be_meant_is_refused_with_its_line(tmp_path, text, said):
    with pytest.raises(ConfigError) as caught:
        loaded(tmp_path, TRAINED + text)
    for part in said:
        assert part in str(caught.value)


def test_the_command_line_is_read_as_a_file_is(tmp_path):
    file = tmp_path / "study.yaml"
    file.write_text(TRAINED)
    changes = ["imitation={goal: off}", "training={steps: 1e3}", "seeds=[5]", "expert={kind: sac}"]
    study = load_study(read_study([file], changes))
    assert (study.imitation.goal, study.training.steps, study.seeds) == ("off", 1000, (5,))
    assert study.expert.kind == "sac" and study.tasks == ("myo/reach",)
    with pytest.raises(ConfigError, match="--config seeds=.0, line 1: not readable"):
        read_study([file], ["seeds=[0"])
