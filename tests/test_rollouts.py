"""Contracts of the demonstrations: what is kept, that it is all there, and that it can be seen again."""

import json
from pathlib import Path

import numpy as np
import pytest
import torch

from acgd.collection import demonstrations as collecting
from acgd.collection import onpolicy
from acgd.collection.demonstrations import run_wave
from acgd.collection.settings import OnPolicyRequest, RolloutsConfig, RolloutsRequest
from acgd.experts.policy import Expert
from acgd.rollouts.dataset import Demonstrations
from acgd.rollouts.rerender import rerender
from acgd.rollouts.store import DamagedStoreError, read_attributes, read_group, write_group
from acgd.rollouts.windows import Windows
from acgd.simulate.lockstep import Lockstep
from acgd.simulate.seeds import SEEDS, round_seeds
from acgd.store.metrics import Metrics
from acgd.store.progress import Progress
from acgd.store.stage import Context
from acgd.students.settings import ActingConfig, RoundsConfig
from acgd.tasks import registry
from acgd.tasks.settings import ImageConfig, TaskConfig

TASK = TaskConfig(name="myo/reach")
CPU = torch.device("cpu")


def context(folder: Path) -> Context:
    for part in ("out", "state"):
        (folder / part).mkdir(parents=True, exist_ok=True)
    return Context(folder / "out", folder / "state", Metrics(folder / "out/metrics.jsonl"), Progress(), CPU)


def payload(folder: Path) -> dict[str, bytes]:
    return {str(f.relative_to(folder)): f.read_bytes() for f in sorted(folder.rglob("*")) if f.is_file()}


@pytest.fixture(scope="module")
def expert(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("expert")
    size = registry.make(TASK, image_size=None).observation_space["state"].shape[0]
    Expert.random(size, 39).save(folder)
    return folder


def invented(expert, lock, seeds, config) -> list[dict]:
    """Episodes as `run_wave` gives them, without a simulator: seeds that 3 divides fail."""
    episodes = []
    for seed in seeds:
        rng, steps = np.random.default_rng(seed), 2 + seed % 4
        floats = {"proprio": 5, "state": 7, "action": 3, "mean_action": 3}
        episode = {name: rng.standard_normal((steps, n)).astype(np.float32) for name, n in floats.items()}
        episode["image"] = rng.integers(0, 255, (steps, 8, 8, 3)).astype(np.uint8)
        episode["integration"] = rng.standard_normal((steps, 4))
        episode |= {name: rng.standard_normal((steps, 2)) for name in ("qpos", "qvel")}
        episode["reward"] = episode["reward_terms/b"] = np.full(steps, seed, np.float32)
        episode["reward_terms/a"] = np.zeros(steps, np.float32)
        episode["solved"] = np.ones(steps, bool)
        episode |= {f"final_{name}": episode[name][-1] for name in ("image", "proprio", "state", "integration")}
        episode |= {
            "model_fields/site_pos": rng.standard_normal((2, 3)),
            "seed": np.int64(seed),
            "terminated": np.bool_(False),
        }
        episode |= {f"success_{rule}": np.bool_(seed % 3 > 0) for rule in ("final", "held", "once")}
        episodes.append(episode)
    return episodes


@pytest.fixture
def simulated(monkeypatch) -> list[list[int]]:
    """Collecting without a simulator; the waves that were run."""
    waves: list[list[int]] = []

    def run(expert, lock, seeds, config):
        waves.append(list(seeds))
        return invented(expert, lock, seeds, config)

    monkeypatch.setattr(collecting, "run_wave", run)
    monkeypatch.setattr(collecting, "_environments", lambda request, expert: object())
    return waves


def collect(folder: Path, expert: Path, **settings) -> Path:
    request = RolloutsRequest(task=TASK, image=ImageConfig(size=32), rollouts=RolloutsConfig(**settings))
    collecting.collect(request, {"expert": expert}, context(folder))
    return folder / "out"


def test_only_successes_are_kept_in_the_order_of_their_seeds(tmp_path, expert, simulated):
    out = collect(tmp_path, expert, demonstrations=7, lockstep=4)
    demos = Demonstrations.load(out, ["success_final", "reward", "reward_terms", "action"])
    tried = sum(simulated, [])
    assert tried == SEEDS.demonstrations.take(len(tried))
    assert demos.seeds.tolist() == [seed for seed in tried if seed % 3][:7]
    assert demos.arrays["success_final"].all()
    assert demos.lengths.tolist() == [2 + seed % 4 for seed in demos.seeds]
    assert demos.reward_terms == ("a", "b") and (demos.arrays["reward_terms"][:, 1] == demos.arrays["reward"]).all()
    summary = json.loads((out / "summary.json").read_text())
    assert summary["failed_seeds"] == [seed for seed in tried if seed % 3 == 0]
    assert summary["attempts"] == len(tried) and summary["demonstrations"] == 7
    with pytest.raises(FileNotFoundError, match="keep_failures"):
        Demonstrations.load(out, ["action"], failures=True)


def test_failures_are_kept_on_request(tmp_path, expert, simulated):
    out = collect(tmp_path, expert, demonstrations=7, lockstep=4, keep_failures=True)
    failures = Demonstrations.load(out, ["success_final", "image"], failures=True)
    assert failures.seeds.tolist() == json.loads((out / "summary.json").read_text())["failed_seeds"]
    assert not failures.arrays["success_final"].any() and len(failures.arrays["image"]) == failures.lengths.sum()


def test_an_interrupted_collection_gives_the_same_bytes(tmp_path, expert, simulated, monkeypatch):
    whole = collect(tmp_path / "whole", expert, demonstrations=9, lockstep=4)
    run, ran = collecting.run_wave, []

    def killed_in_the_third_wave(expert, lock, seeds, config):
        if len(ran) == 2:
            raise KeyboardInterrupt
        ran.append(seeds)
        return run(expert, lock, seeds, config)

    monkeypatch.setattr(collecting, "run_wave", killed_in_the_third_wave)
    with pytest.raises(KeyboardInterrupt):
        collect(tmp_path / "resumed", expert, demonstrations=9, lockstep=4)
    monkeypatch.setattr(collecting, "run_wave", run)
    simulated.clear()
    resumed = collect(tmp_path / "resumed", expert, demonstrations=9, lockstep=4)
    assert all(seeds not in simulated for seeds in ran), "a finished wave is not run again"
    assert payload(whole) == payload(resumed)


def test_an_expert_that_never_succeeds_is_refused_with_the_mend(tmp_path, expert, simulated, monkeypatch):
    def failing(*arguments):
        return [{**episode, "success_final": np.bool_(False)} for episode in invented(*arguments)]

    monkeypatch.setattr(collecting, "run_wave", failing)
    with pytest.raises(collecting.ExpertTooWeakError, match="solved 0 of 6 episodes.*expert.kind"):
        collect(tmp_path, expert, demonstrations=3, lockstep=2, attempts=2)


@pytest.fixture(scope="module")
def real(tmp_path_factory, expert) -> Path:
    """Three episodes of an untrained expert on the real task, all taken for successes."""
    folder = tmp_path_factory.mktemp("real")

    def accepted(*arguments):
        return [{**episode, "success_final": np.bool_(True)} for episode in run_wave(*arguments)]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(collecting, "run_wave", accepted)
        return collect(folder, expert, demonstrations=3, lockstep=2, noise=0.1)


def test_an_episode_renders_again_to_the_same_frames(real):
    demos = Demonstrations.load(real, ["image", "final_image"])
    frames = rerender(real, TASK)
    for e, (start, end) in enumerate(zip(demos.episode_starts, demos.episode_ends)):
        assert np.array_equal(frames[e][:-1], demos.arrays["image"][start:end])
        assert np.array_equal(frames[e][-1], demos.arrays["final_image"][e])
    assert len({frame.tobytes() for frame in frames[0]}) > 1, "nothing moves in the recording"


def test_recorded_actions_lead_to_the_recorded_states(real):
    demos = Demonstrations.load(real, ["action", "mean_action", "state", "final_state", "reward", "qpos"])
    env = registry.make(TASK, image_size=None)
    env.reset(seed=int(demos.seeds[1]))
    for t in range(demos.episode_starts[1], demos.episode_ends[1]):
        assert np.array_equal(env.data.qpos, demos.arrays["qpos"][t])
        obs, reward, *_ = env.step(demos.arrays["action"][t])
        assert np.float32(reward) == demos.arrays["reward"][t]
    assert np.array_equal(obs["state"], demos.arrays["final_state"][1])
    difference = demos.arrays["action"] - demos.arrays["mean_action"]
    assert np.abs(difference).max() > 0.05 and np.abs(demos.arrays["action"]).max() <= 1


def test_a_wave_depends_on_its_seeds_alone(expert):
    lock = Lockstep(TASK, 2, image_size=None)
    config = RolloutsConfig(noise=0.1)
    seeds = SEEDS.demonstrations.take(2, offset=5)
    first = run_wave(Expert.load(expert), lock, seeds, config)
    again = run_wave(Expert.load(expert), lock, seeds, config)
    for one, other in zip(first, again):
        assert one.keys() == other.keys() and all(np.array_equal(one[name], other[name]) for name in one)


def test_other_sizes_can_be_drawn_later(real):
    assert rerender(real, TASK, [0])[0].shape[1:] == (32, 32, 3)
    assert rerender(real, TASK, [0], image_size=48)[0].shape[1:] == (48, 48, 3)


# -- on-policy rounds ----------------------------------------------------------------------------


class Still:
    """A student that holds still, and remembers what it has been given."""

    tasks = ("myo/pose", TASK.name)
    goal = "any"

    def __init__(self) -> None:
        self.started, self.entries = [], set()

    def start(self, tasks, goals, seeds):
        self.started.append((tasks.tolist(), goals, seeds))
        return 0

    def act(self, observations, memory):
        self.entries |= set(observations)
        return np.full((len(observations["proprio"]), 39), -0.5, np.float32), memory + 1


def on_policy(folder: Path, expert: Path, demos: Path, episodes: int = 3, **rounds) -> tuple[Path, Still]:
    """One round of a student that holds still."""
    student = Still()
    request = OnPolicyRequest(
        task=TASK,
        image=ImageConfig(size=32),
        acting=ActingConfig(),
        rounds=RoundsConfig(episodes=episodes, **rounds),
        round=2,
        seed=4,
    )
    inputs = {"expert": expert, "student": Path("none"), "backbone": Path("none"), "rollouts": demos}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(onpolicy, "LOCKSTEP", 2)
        patch.setattr(onpolicy, "load_policy", lambda *arguments, **options: student)
        onpolicy.collect(request, inputs, context(folder))
    return folder / "out", student


@pytest.fixture(scope="module")
def mixed(tmp_path_factory, expert, real) -> tuple[Path, Still]:
    return on_policy(tmp_path_factory.mktemp("mixed"), expert, real, beta=0.7)


def test_an_on_policy_round_mixes_student_and_expert_by_chance(mixed, expert):
    out, _ = mixed
    demos = Demonstrations.load(out, ["action", "mean_action", "by_expert", "state"])
    by_expert, action = demos.arrays["by_expert"], demos.arrays["action"]
    assert demos.seeds.tolist() == round_seeds(4, 2, 3)
    assert np.array_equal(action[by_expert], demos.arrays["mean_action"][by_expert])
    assert (action[~by_expert] == -0.5).all()
    assert np.allclose(demos.arrays["mean_action"], Expert.load(expert).mean(demos.arrays["state"]), atol=1e-5)
    for start, end, seed in zip(demos.episode_starts, demos.episode_ends, demos.seeds):
        draws = np.random.default_rng([seed, 3]).random(end - start)
        assert np.array_equal(by_expert[start:end], draws < 0.7**2)


def test_an_on_policy_round_keeps_failures_and_counts(mixed):
    out, _ = mixed
    success = Demonstrations.load(out, ["success_final"]).arrays["success_final"]
    demos = Demonstrations.load(out, ["by_expert"])
    summary = json.loads((out / "summary.json").read_text())
    assert len(success) == summary["episodes"] == 3 and not success.any() and summary["failures"] == 3
    assert summary["environment_steps"] == summary["expert_queries"] == demos.episode_ends[-1]
    assert summary["steps_by_expert"] == demos.arrays["by_expert"].sum()


def test_the_student_of_a_round_is_given_its_task_and_goals(mixed, real):
    from acgd.evaluation.goals import training_goals

    _, student = mixed
    (tasks, goals, seeds), _ = student.started
    assert tasks == [1, 1] and seeds == round_seeds(4, 2, 2)
    assert np.array_equal(goals, training_goals(real, seeds))


def test_the_student_of_a_round_is_given_the_commanded_goals_that_it_was_trained_with(tmp_path, expert, real):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Still, "goal", "vector")
        out, student = on_policy(tmp_path, expert, real, beta=0.0)
    (_, goals, _), _ = student.started
    stored = Demonstrations.load(out, ["goal"]).arrays["goal"]
    assert goals.dtype == stored.dtype == np.float32 and np.array_equal(goals, stored[:2])


def test_without_labels_no_mean_is_stored_and_only_actions_of_the_expert_count(tmp_path, expert, real):
    out, _ = on_policy(tmp_path / "half", expert, real, episodes=2, labels="none", beta=0.7)
    summary = json.loads((out / "summary.json").read_text())
    assert "mean_action" not in read_attributes(out / "rollouts.zarr")["chunks"]
    assert 0 < summary["expert_queries"] == summary["steps_by_expert"] < summary["environment_steps"]
    alone, _ = on_policy(tmp_path / "alone", expert, real, episodes=2, labels="none", beta=0.0)
    assert json.loads((alone / "summary.json").read_text())["expert_queries"] == 0
    assert (Demonstrations.load(alone, ["action"]).arrays["action"] == -0.5).all()


def test_an_interrupted_round_gives_the_same_bytes(tmp_path, mixed, expert, real, monkeypatch):
    run, ran = onpolicy.run_wave, []

    def killed_in_the_second_wave(*arguments, **options):
        if ran:
            raise KeyboardInterrupt
        ran.append(arguments)
        return run(*arguments, **options)

    monkeypatch.setattr(onpolicy, "run_wave", killed_in_the_second_wave)
    with pytest.raises(KeyboardInterrupt):
        on_policy(tmp_path, expert, real, beta=0.7)
    waves: list[list[int]] = []

    def counted(*arguments, **options):
        waves.append(arguments[3])
        return run(*arguments, **options)

    monkeypatch.setattr(onpolicy, "run_wave", counted)
    out, _ = on_policy(tmp_path, expert, real, beta=0.7)
    assert waves == [round_seeds(4, 2, 3)[2:]] and payload(out) == payload(mixed[0])


@pytest.fixture
def arrays(tmp_path) -> tuple[Path, dict[str, np.ndarray]]:
    rng = np.random.default_rng(0)
    content = {
        "image": rng.integers(0, 255, (150, 8, 8, 3)).astype(np.uint8),
        "black": np.zeros((150, 8, 8, 3), np.uint8),
        "state": rng.standard_normal((150, 7)).astype(np.float32),
        "solved": rng.random(150) > 0.5,
        "model_fields/site_pos": rng.standard_normal((2, 4, 3)),
        "empty": np.zeros((2, 0)),
    }
    write_group(tmp_path / "g.zarr", content, {"note": "x"})
    return tmp_path / "g.zarr", content


def test_written_arrays_are_read_back(arrays):
    path, content = arrays
    found = read_group(path, list(content))
    for name, value in content.items():
        assert found[name].dtype == value.dtype and np.array_equal(found[name], value)
    with pytest.raises(KeyError, match="it has .*solved"):
        read_group(path, ["nothing"])


def test_the_same_content_is_the_same_bytes(arrays, tmp_path):
    path, content = arrays
    write_group(tmp_path / "again.zarr", content, {"note": "x"})
    assert payload(path) == payload(tmp_path / "again.zarr")


@pytest.mark.parametrize(
    "file", ["image/c/1/0/0/0", "black/c/2/0/0/0", "model_fields/site_pos/c/0/0/0", "state/zarr.json"]
)
def test_a_missing_file_is_an_error_that_names_it(arrays, file):
    path, _ = arrays
    (path / file).unlink()
    with pytest.raises(DamagedStoreError, match=f"{file} .*run the same command again"):
        read_group(path, ["solved"])


@pytest.mark.parametrize("damage", ["flipped", "cut", "emptied"])
def test_a_corrupted_chunk_is_an_error_that_names_it(arrays, damage):
    path, _ = arrays
    chunk = path / "image/c/1/0/0/0"
    content = bytearray(chunk.read_bytes())
    content[len(content) // 2] ^= 1
    chunk.write_bytes({"flipped": content, "cut": content[: len(content) // 2], "emptied": b""}[damage])
    with pytest.raises(DamagedStoreError, match="image/c/1/0/0/0"):
        read_group(path, ["image"])


def demonstrations(lengths: list[int], width: int, first: int) -> Demonstrations:
    """Episodes whose `value` at step t is first + t."""
    steps = sum(lengths)
    value = np.repeat(np.arange(first, first + steps, dtype=np.float32)[:, None], width, axis=1)
    return Demonstrations({"value": value}, np.cumsum(lengths), np.arange(len(lengths)), (), {})


def test_windows_by_hand():
    tasks = [demonstrations([3, 2], width=1, first=0), demonstrations([4, 2], width=2, first=10)]
    windows = Windows.join(tasks, [demo.arrays for demo in tasks], [{"seed": demo.seeds} for demo in tasks], CPU)
    assert windows.task.tolist() == [0] * 5 + [1] * 6
    assert windows.episode.tolist() == [0, 0, 0, 1, 1, 2, 2, 2, 2, 3, 3]
    t = torch.tensor([1, 4, 5, 7])
    chunk, mask = windows.chunk_of("value", t, 3)
    assert chunk[:, :, 0].tolist() == [[1, 2, 2], [4, 4, 4], [10, 11, 12], [12, 13, 13]]
    assert mask.tolist() == [[True, True, False], [True, False, False], [True, True, True], [True, True, False]]
    history = windows.history_of("value", t, 2)
    assert history[:, :, 0].tolist() == [[0, 0, 1], [3, 3, 4], [10, 10, 10], [10, 11, 12]]
    assert chunk[0, :, 1].tolist() == [0, 0, 0], "the narrower task is padded with zeros"
    assert chunk[2, :, 1].tolist() == [10, 11, 12]
    assert windows.episode_task[windows.episode[t]].tolist() == windows.task[t].tolist()


def test_the_split_is_by_episode_and_always_the_same():
    demo = demonstrations([3] * 20, 1, 0)
    train, held_out = demo.split()
    assert (train.tolist(), held_out.tolist()) == tuple(
        part.tolist() for part in demonstrations([5] * 20, 1, 9).split()
    )
    assert len(held_out) == 2 and sorted([*train, *held_out]) == list(range(20))
    assert not set(demo.steps_of(train)) & set(demo.steps_of(held_out))
    windows = Windows.join([demo], [demo.arrays], [{}], CPU)
    assert not set(windows.episode[windows.training].tolist()) & set(windows.episode[windows.validation].tolist())
    assert len(demonstrations([3, 3], 1, 0).split()[1]) == 1, "two episodes: one of each"
