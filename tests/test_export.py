"""Exports: every number comes back, read by the formats' own libraries where these are installed; episodes replay."""

import json
import os
import subprocess
import sys
from pathlib import Path

import h5py
import numpy as np
import pyarrow.parquet as pq
import pytest
import torch
from synthetic import STUDENTS, A, F, P

from acgd.__main__ import main
from acgd.export.commands import settings_of
from acgd.export.destination import SUMS
from acgd.export.kinds import EXPORTS
from acgd.export.onnx.graph import Graph
from acgd.export.onnx.parity import Inputs, measure
from acgd.export.recording import Recordings
from acgd.export.replay import read, replay
from acgd.settings import imported
from acgd.store.job import make
from acgd.store.store import ArtifactError, Store
from acgd.students.kinds import STUDENTS as STUDENT_KINDS
from acgd.students.load import new_student, policy_of
from acgd.students.settings import ActingConfig, ImitationConfig
from acgd.students.student import Sizes
from acgd.study.load import read_yaml
from acgd.study.plan import identity, plan
from acgd.study.study import load_study

ROOT = Path(__file__).parent.parent
PEERS = Path(os.environ.get("ACGD_PEERS", ROOT / ".peers")) / "bin/python"
DATASETS = [name for name, kind in EXPORTS.items() if "rollouts" in imported(kind.settings).stages]
COLUMNS = {
    "lerobot": {
        "action": "action",
        "proprio": "observation.state",
        "state": "observation.environment_state",
        "reward": "next.reward",
        "solved": "next.success",
        "mean_action": "expert.action",
        "image": "observation.images.camera",
    },
    "robomimic": {
        "action": "actions",
        "proprio": "obs/proprio",
        "state": "obs/state",
        "reward": "rewards",
        "solved": "solved",
        "mean_action": "mean_action",
        "image": "obs/image",
        "integration": "states",
    },
    "minari": {
        "action": "actions",
        "proprio": "observations/proprio",
        "state": "observations/state",
        "reward": "rewards",
        "image": "observations/image",
    },
}
"""Array of the store -> column of the format."""


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Two tasks' rollouts, and an untrained student of each kind, in a store with names."""
    folder = tmp_path_factory.mktemp("export")
    content = read_yaml(ROOT / "tests/miniature.yaml") | {
        "rollouts": {"demonstrations": 3, "lockstep": 3},
        "variants": {
            "acgd": {"guidance": {"kind": "none"}},
            "bc": {"student": {"kind": "bc", "width": 16}, "guidance": {"kind": "none"}},
            "scratch": {"backbone": {"kind": "scratch", "dim": 8}, "imitation": {"goal": "own"}},
            "bc_rnn": {"student": {"kind": "bc_rnn", "width": 16}, "imitation": {"goal": "vector", "frames": 2}},
        },
    }
    content["variants"]["scratch"] |= {"student": {"kind": "bc", "width": 16}, "guidance": {"kind": "none"}}
    content["variants"]["bc_rnn"] |= {"guidance": {"kind": "none"}}
    study, store = load_study(content), Store(folder / "results")
    planned = plan(study)

    def produce(artifact):
        for one in artifact.upstream:
            produce(one)
        if not store.has(artifact.place):
            make(json.loads(artifact.job), artifact.stage, identity, store, 1, "cpu")

    for name, artifacts in planned.names.items():
        if name.split("/")[-1] in ("rollouts", "student"):
            for artifact in artifacts:
                produce(artifact)
            file = store.results / study.name / name
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_text("".join(f"results/store/{artifact.place}\n" for artifact in artifacts))
    return store.results / study.name


@pytest.fixture(scope="module")
def exported(made, tmp_path_factory):
    """Format -> folder of an export: of both tasks, by name, and of LeRobot as films, too."""
    folder = tmp_path_factory.mktemp("exported")
    for name in DATASETS:
        assert main(["export", "rollouts", f"{made}/bc/rollouts", "--format", name, "--out", f"{folder}/{name}"]) == 0
    films = ["--format", "lerobot", "--set", "images=mp4", "--out", f"{folder}/films"]
    assert main(["export", "rollouts", f"{made}/bc/rollouts", *films]) == 0
    return {name: folder / name for name in (*DATASETS, "films")}


def recordings(made):
    """Slug -> what was recorded, in the order of the export."""
    lines = (made / "bc/rollouts").read_text().split()
    return [Recordings.load(made.parent.parent / line) for line in lines]


def same(format, name, ours, theirs):
    """The export's array, without the padding of a narrower task and without the final observation."""
    theirs = theirs[: len(ours), ..., : ours.shape[-1]] if ours.ndim == 2 else theirs[: len(ours)]
    np.testing.assert_array_equal(theirs, ours, err_msg=f"{format} {name}")


@pytest.mark.parametrize("format", DATASETS)
def test_every_array_comes_back_bit_for_bit(made, exported, format):
    ours = [(task, episode) for task in recordings(made) for episode in task]
    theirs = list(read(exported[format], images=True))
    assert len(ours) == len(theirs) == 6
    for (task, episode), got in zip(ours, theirs):
        assert got.beginning.task == task.task.model_dump() and got.beginning.seed == episode.seed
        for name, column in COLUMNS[format].items():
            same(format, name, episode.steps[name], got.columns[column])


def test_films_are_close_to_the_images(made, exported):
    ours = [episode for task in recordings(made) for episode in task]
    for episode, got in zip(ours, read(exported["films"], images=True)):
        film = got.columns["observation.images.camera"].astype(int)
        assert film.shape == episode.steps["image"].shape
        assert np.abs(film - episode.steps["image"]).mean() < 4


@pytest.mark.parametrize("format", DATASETS)
def test_episodes_replayed_from_the_files_alone_go_as_they_went(made, exported, format):
    ours = [episode for task in recordings(made) for episode in task]
    for episode, got in zip(ours, replay(read(exported[format]))):
        assert got.recorded and got.replayed
        np.testing.assert_array_equal(got.states, episode.whole("state"))


@pytest.mark.parametrize("format", DATASETS)
def test_card_and_checksums(exported, format):
    folder = exported[format]
    subprocess.run(["sha256sum", "--check", "--quiet", SUMS], cwd=folder, check=True)
    card = (folder / "README.md").read_text()
    assert card.startswith("---\nlicense: apache-2.0\n")
    assert "| myo/reach | perturbed | 3 |" in card and "10000000 to 1000000" in card and "    python -m acgd" in card


def peers(format, folder, result):
    subprocess.run([PEERS, ROOT / "tests/peers_read.py", format, folder, result], check=True, cwd=result.parent)
    return np.load(result)


@pytest.mark.skipif(not PEERS.exists(), reason="scripts/peer-environment.sh makes the environment of the peers")
@pytest.mark.parametrize("format", DATASETS)
def test_the_format_s_own_library_reads_the_same(made, exported, format, tmp_path):
    tasks, folder = recordings(made), exported[format]
    if format != "lerobot":  # which has one dataset for all tasks
        tasks, folder = tasks[1:], tmp_path / "one"
        name = f"{made}/bc/myo-reach/rollouts"
        assert main(["export", "rollouts", name, "--format", format, "--out", str(folder)]) == 0
    theirs = peers(format, folder, tmp_path / "result.npz")
    for at, episode in enumerate(episode for task in tasks for episode in task):
        for name in ("action", "proprio", "state", "image"):
            same(format, name, episode.steps[name], theirs[f"{at}/{name}"])
    if format == "lerobot":
        actions = np.concatenate([episode.steps["action"] for task in tasks for episode in task])
        np.testing.assert_allclose(theirs["mean"], actions.mean(0), atol=1e-6)
        assert json.loads(str(theirs["features"]))["action"] == ["ACTION", [39]]
        assert theirs["chunk"].shape == (4, 39)
    if format == "robomimic":
        training, validation = tasks[0].demonstrations.split()
        assert theirs["train"].tolist() == training.tolist() and theirs["valid"].tolist() == validation.tolist()


def test_the_environments_that_files_name_are_made(exported):
    import gymnasium
    from gymnasium.envs.registration import EnvSpec

    (metadata,) = exported["minari"].glob("acgd/myo-reach/*/data/metadata.json")
    env = gymnasium.make(EnvSpec.from_json(json.loads(metadata.read_text())["env_spec"]))
    with h5py.File(exported["robomimic"] / "myo-reach.hdf5") as file:
        said = json.loads(file["data"].attrs["env_args"])
        first = file["data/demo_0/obs/state"][0]
        seed = int(file["data/demo_0"].attrs["seed"])
    for made_env in (env, gymnasium.make(said["env_name"], **said["env_kwargs"])):
        np.testing.assert_array_equal(made_env.reset(seed=seed)[0]["state"], first)


def test_tasks_are_known_to_gymnasium_after_importing_them():
    for lines in ("import acgd.tasks, gymnasium", "import gymnasium, acgd.tasks"):
        code = f"{lines}; print('acgd/myo-key-turn-v0' in gymnasium.registry)"
        found = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
        assert found.stdout.strip() == "True"


def test_large_datasets_go_to_several_files(made, tmp_path, monkeypatch):
    monkeypatch.setattr("acgd.export.lerobot.write.DATA_MB", 0.1)
    name = f"{made}/bc/rollouts"
    assert main(["export", "rollouts", name, "--format", "lerobot", "--out", str(tmp_path / "out")]) == 0
    files = sorted((tmp_path / "out/data").rglob("*.parquet"))
    assert len(files) > 1
    frames = sum(len(episode.columns["action"]) for episode in read(tmp_path / "out"))
    assert sum(pq.read_metadata(file).num_rows for file in files) == frames


# -- bad input ------------------------------------------------------------------------------------


def refused(capsys, *arguments):
    assert main(["export", *map(str, arguments)]) == 1
    return capsys.readouterr().err


def test_bad_input_is_refused_and_nothing_is_written(made, tmp_path, capsys):
    out, name = tmp_path / "out", f"{made}/bc/rollouts"
    assert "formats of rollouts: lerobot, robomimic, minari" in refused(
        capsys, "rollouts", name, "--format", "onnx", "--out", out
    )
    assert "cannot be exported as 'tfds'" in refused(capsys, "rollouts", name, "--format", "tfds", "--out", out)
    assert "no artifact and no name" in refused(capsys, "rollouts", "nothing", "--format", "minari", "--out", out)
    assert "images: Input should be" in refused(
        capsys, "rollouts", name, "--format", "lerobot", "--out", out, "--set", "images=gif"
    )
    assert "of the stage student" in refused(
        capsys, "rollouts", f"{made}/bc/student", "--format", "minari", "--out", out
    )
    assert "several artifacts are of one task" in refused(
        capsys, "rollouts", _twice(made, tmp_path), "--format", "minari", "--out", out
    )
    assert not out.exists()
    out.mkdir()
    (out / "mine.txt").write_text("mine")
    assert "holds something already" in refused(capsys, "rollouts", name, "--format", "minari", "--out", out)
    assert [file.name for file in out.iterdir()] == ["mine.txt"]


def _twice(made, folder):
    line = (made / "bc/myo-reach/rollouts").read_text().strip()
    (folder / "twice").write_text(f"{made.parent.parent / line}\n" * 2)
    return folder / "twice"


def test_a_damaged_store_is_refused(made, tmp_path, capsys):
    import shutil

    line = (made / "bc/myo-reach/rollouts").read_text().strip()
    shutil.copytree(made.parent.parent / line, tmp_path / "damaged")
    chunk = tmp_path / "damaged/rollouts.zarr/image/c/0/0/0/0"
    chunk.write_bytes(chunk.read_bytes()[:-1] + b"x")
    assert "is damaged: rollouts.zarr/image" in refused(
        capsys, "rollouts", tmp_path / "damaged", "--format", "lerobot", "--out", tmp_path / "out"
    )
    assert not (tmp_path / "out").exists()


def test_an_export_that_fails_leaves_nothing(made, tmp_path, monkeypatch):
    monkeypatch.setattr("acgd.export.lerobot.write._png", lambda image: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        main(["export", "rollouts", f"{made}/bc/rollouts", "--format", "lerobot", "--out", str(tmp_path / "out")])
    assert list(tmp_path.iterdir()) == []


def test_a_foreign_dataset_is_not_replayed(exported, tmp_path, capsys):
    (tmp_path / "meta").mkdir()
    (tmp_path / "meta/info.json").write_text('{"codebase_version": "v2.1"}')
    assert main(["replay", str(tmp_path)]) == 1
    assert "v3.0 is read" in capsys.readouterr().err


# -- students -------------------------------------------------------------------------------------


MODES = ["ensemble-paper", "ensemble-act", "first", "open-loop"]
STEPPED = [(kind, mode, {}) for kind in ("acgd", "act", "chunk") for mode in MODES]
STEPPED += [(kind, "ensemble-paper", {}) for kind in ("bc", "bc_rnn")]
STEPPED += [
    (kind, "ensemble-paper", imitation)
    for kind in STUDENTS
    for imitation in ({"frames": 3, "frame_stride": 2, "goal": "off"}, {"goal": "vector"})
]
G = 4
"""Numbers in a commanded goal, of which the task has one fewer."""


def untrained(kind, mode, imitation):
    """A student of nine steps of three episodes: module, policy and inputs."""
    torch.manual_seed(0)
    settings = imported(STUDENT_KINDS[kind].settings)(**STUDENTS[kind])
    imitation, acting = ImitationConfig(**imitation), ActingConfig(mode=mode, eta=0.3)
    vector, backbone = imitation.goal == "vector", Pixels()
    sizes = Sizes(F, P, A, 2, owns_cnn=False, goal=G if vector else 0)
    student = new_student(settings, imitation, sizes).eval().requires_grad_(False)
    rng = np.random.default_rng(0)
    images = rng.integers(0, 256, (9, 3, 8, 8, 3), dtype=np.uint8)
    proprio = rng.normal(size=(9, 3, P)).astype(np.float32)
    numbers, known = np.array([0, 1, 2]), rng.integers(0, 256, (3, 8, 8, 3), dtype=np.uint8)
    inputs = Inputs(images, proprio, 1, numbers, known)
    if vector:
        commanded = rng.normal(size=(3, G - 1)).astype(np.float32)
        inputs = inputs._replace(goals=np.pad(commanded, ((0, 0), (0, 1))), policy_goals=commanded)
    goals = [backbone(torch.from_numpy(known))] * 2 if imitation.goal == "any" else None
    policy = policy_of(student, backbone, acting, tasks=["one", "two"], rows=3)
    return Graph(backbone, student, acting, goals).eval(), policy, inputs


@pytest.mark.parametrize(("kind", "mode", "imitation"), STEPPED)
def test_one_step_as_a_function_is_the_policy(kind, mode, imitation):
    graph, policy, inputs = untrained(kind, mode, imitation)
    parity = measure(None, graph, policy, [inputs])
    assert parity.steps == 27 and parity.policy < 1e-6


@pytest.mark.parametrize("kind", STUDENTS)
def test_the_model_of_every_kind_is_the_student(kind, tmp_path):
    pytest.importorskip("onnx", reason="requirements.txt names it")
    from acgd.export.onnx.write import export, session_of

    graph, policy, inputs = untrained(kind, "ensemble-paper", {"frames": 2, "frame_stride": 2, "goal": "vector"})
    with torch.no_grad():
        export(graph, inputs, tmp_path / "student.onnx")
    pair = Inputs(inputs.images[:, :2], inputs.proprio[:, :2], inputs.task, inputs.goals[:2], inputs.policy_goals[:2])
    parity = measure(session_of(tmp_path / "student.onnx"), graph, policy, [inputs, pair])
    assert parity.steps == 27 + 18 and max(parity.action, parity.memory, parity.policy) < 1e-5


@pytest.mark.parametrize("change", [{"reset": False}, {"head": "l1"}, {"modes": 1}])
def test_one_step_of_a_recurrent_student_is_its_policy(change, monkeypatch):
    monkeypatch.setitem(STUDENTS, "bc_rnn", STUDENTS["bc_rnn"] | change)
    graph, policy, inputs = untrained("bc_rnn", "first", {})
    assert measure(None, graph, policy, [inputs]).policy < 1e-6


def test_a_recurrent_kind_must_say_how_it_acts(monkeypatch):
    from acgd.students.bc_rnn.model import BCRNN

    monkeypatch.delattr(BCRNN, "stepping")
    with pytest.raises(ArtifactError, match="bc_rnn is recurrent.*must offer `stepping`"):
        untrained("bc_rnn", "first", {})


class Pixels(torch.nn.Module):
    """Images to a few of their pixels."""

    def forward(self, images):
        return images.flatten(1)[:, :F].float() / 255


@pytest.mark.parametrize("variant", ["acgd", "scratch", "bc_rnn"])
def test_a_student_as_onnx_is_the_student(made, tmp_path, variant):
    pytest.importorskip("onnx", reason="requirements.txt names it")
    name, out = f"{made}/{variant}/seed-0/student", tmp_path / "out"
    assert main(["export", "student", name, "--format", "onnx", "--out", str(out), "--set", "acting.eta=0.5"]) == 0
    card = (out / "README.md").read_text()
    assert "Largest difference to the student in torch" in card and "| task | condition |" in card
    assert ("eta 0.5" in card) == (variant == "acgd") and ("(B, G) float32" in card) == (variant == "bc_rnn")
    sys.path.insert(0, str(ROOT / "examples"))
    try:
        from play import play
    finally:
        sys.path.pop(0)
    if variant == "acgd":
        assert set(play(str(out / "student.onnx"), episodes=1)) == {"myo/obj-hold", "myo/reach"}
    if variant == "bc_rnn":
        assert set(play(str(out / "student.onnx"), "myo/obj-hold", episodes=1)) == {"myo/obj-hold"}


def test_a_kind_that_acts_otherwise_must_say_how(made, tmp_path, capsys, monkeypatch):
    pytest.importorskip("onnx", reason="requirements.txt names it")
    from acgd.students.bc.model import BCPolicy

    act = BCPolicy.act
    monkeypatch.setattr(BCPolicy, "act", lambda *given: (act(*given)[0] * 0.9, given[-1]))
    error = refused(capsys, "student", f"{made}/bc/seed-0/student", "--format", "onnx", "--out", tmp_path / "out")
    assert "kind must offer `stepping`" in error


def test_every_setting_of_a_format_is_described():
    for kind in EXPORTS.values():
        for name, field in imported(kind.settings).model_fields.items():
            assert name == "kind" or field.description.endswith(".")
    assert settings_of("rollouts", "minari", ["version=2"]).version == 2
