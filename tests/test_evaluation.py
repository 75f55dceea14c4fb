"""Evaluation: episodes that depend on their seed alone, policies, controls, goals."""

import filecmp
import io
from pathlib import Path

import numpy as np
import pytest
import torch
from imageio_ffmpeg import count_frames_and_secs, read_frames

from acgd.collection import onpolicy
from acgd.collection.onpolicy import collect as collect_on_policy
from acgd.collection.settings import OnPolicyRequest
from acgd.evaluation.clips import clips, film, write_mp4
from acgd.evaluation.controls import CONTROLS, controls, nearest, replay, replay_nearest
from acgd.evaluation.episodes import Episode, Label, read, read_actions, run, run_batch, seeds_of
from acgd.evaluation.evaluate import evaluate
from acgd.evaluation.goals import demonstration_for, oracle_goals, training_goals
from acgd.evaluation.settings import (
    ClipsRequest,
    Condition,
    ControlsConfig,
    ControlsRequest,
    EvaluationConfig,
    EvaluationRequest,
)
from acgd.evaluation.summary import success_rows
from acgd.experts.policy import Expert
from acgd.rollouts.dataset import Demonstrations
from acgd.rollouts.store import write_group
from acgd.simulate.lockstep import Lockstep
from acgd.simulate.policy import (
    STUDENT_ENTRIES,
    FirstThen,
    Mean,
    Mixture,
    Noisy,
    Offset,
    Padded,
    Replay,
    Restricted,
    Sampled,
    ShuffledImages,
    padded,
)
from acgd.simulate.proportion import wilson
from acgd.simulate.record import Episodes
from acgd.simulate.roll import Recorder, roll
from acgd.simulate.seeds import SEEDS, round_seeds
from acgd.store.metrics import Metrics
from acgd.store.progress import Progress
from acgd.store.stage import Context
from acgd.students.acgd.model import ACGD
from acgd.students.acgd.settings import ACGDConfig
from acgd.students.data import Data
from acgd.students.load import load_policy, new_student, save_student
from acgd.students.settings import ActingConfig, ImitationConfig, RoundsConfig
from acgd.students.student import Sizes
from acgd.tasks import registry
from acgd.tasks.settings import ImageConfig, TaskConfig
from acgd.vision.cnn import SmallCNN

PEN = TaskConfig(name="myo/pen-twirl")
"""The shortest episodes: 50 steps at most."""
HOLD = TaskConfig(name="myo/obj-hold")
LABEL = Label("expert", PEN.name, "none", "none", "perturbed")
IMAGE = ImageConfig(size=32)


def context(folder: Path) -> Context:
    out, state = folder / "out", folder / "state"
    out.mkdir(parents=True, exist_ok=True)
    state.mkdir(exist_ok=True)
    return Context(out, state, Metrics(out / "metrics.jsonl"), Progress(io.StringIO()), torch.device("cpu"))


def random_expert(task: TaskConfig) -> Expert:
    env = registry.make(task, image_size=None)
    return Expert.random(
        env.observation_space["state"].shape[0], env.action_space.shape[0], seed=1, meta={"task": task.name}
    )


@pytest.fixture(scope="module")
def expert() -> Expert:
    return random_expert(PEN)


@pytest.fixture(scope="module")
def pen_lock() -> Lockstep:
    return Lockstep(PEN, 2, image_size=None)


@pytest.fixture(scope="module")
def artifacts(tmp_path_factory) -> dict[str, list[Path]]:
    """Rollouts and experts of PEN and HOLD, as the stages publish them, but of an untrained expert."""
    folder = tmp_path_factory.mktemp("artifacts")
    found = {"rollouts": [], "expert": []}
    for task in (PEN, HOLD):
        acts = random_expert(task)
        lock, recorder = Lockstep(task, 3, image_size=IMAGE.size), Episodes()
        roll(lock, Mean(acts), SEEDS.demonstrations.take(3), recorders=[recorder])
        episodes = recorder.episodes()
        arrays = {
            name: np.concatenate([episode[name] for episode in episodes])
            for name in ("action", "state", "proprio", "image")
        }
        arrays["final_image"] = np.stack([episode["final_image"] for episode in episodes])
        arrays["episode_ends"] = np.cumsum([len(episode["action"]) for episode in episodes]).astype(np.int64)
        arrays["seed"] = np.array(SEEDS.demonstrations.take(3), np.int64)
        place = folder / task.name.replace("/", "-")
        (place / "expert").mkdir(parents=True)
        write_group(place / "rollouts.zarr", arrays, {"task": task.name, "reward_terms": [], "state_layout": {}})
        acts.save(place / "expert")
        found["rollouts"].append(place)
        found["expert"].append(place / "expert")
    return found


class Scripted:
    """Known actions (T, n, A); `only`: the one row that is asked for."""

    def __init__(self, actions: np.ndarray, only: int | None = None) -> None:
        self.actions = actions if only is None else actions[:, only : only + 1]

    def start(self, tasks, goals, seeds):
        return 0

    def act(self, observations, memory):
        return self.actions[memory], memory + 1


def test_lockstep_equals_one_after_the_other():
    """With actions that do not depend on the batch, each seed ends the same to the last bit, beside others or alone."""
    seeds = SEEDS.evaluation.take(3)
    rng = np.random.default_rng(0)
    actions = rng.uniform(-1, 0, (50, 3, 39)).astype(np.float32)
    together, _ = run_batch(Lockstep(PEN, 3, image_size=None), seeds, Scripted(actions), LABEL)
    lock = Lockstep(PEN, 1, image_size=None)
    alone = [
        run_batch(lock, [seed], Scripted(actions, only=i), LABEL)[0][0] for i, seed in reversed(list(enumerate(seeds)))
    ]
    assert together == alone[::-1]
    assert len({e.reward for e in together}) == 3


def test_an_episode_does_not_depend_on_how_many_there_are(expert, tmp_path):
    """Fixed batches: the first three of five are the three of three, though their last batch is only half full."""
    seeds, lock, policy = SEEDS.evaluation.take(5), Lockstep(PEN, 2, image_size=None), Padded(Mean(expert), 2)
    with Progress(io.StringIO())(8, "") as bar:
        five, _ = run(lock, seeds, policy, LABEL, tmp_path / "five", bar)
        three, _ = run(lock, seeds[:3], policy, LABEL, tmp_path / "three", bar)
    assert five[:3] == three


def test_a_resumed_run_equals_an_uninterrupted_one(expert, pen_lock, tmp_path):
    seeds = SEEDS.validation.take(5)

    class Watched(Padded):
        """Remembers the batches that it begins, and is killed in one of them."""

        def __init__(self, killed_in: int | None = None) -> None:
            super().__init__(Mean(expert), 2)
            self.batches, self.killed_in = [], killed_in

        def start(self, tasks, goals, seeds):
            self.batches.append(seeds)
            if len(self.batches) == self.killed_in:
                raise KeyboardInterrupt
            return super().start(tasks, goals, seeds)

    with Progress(io.StringIO())(15, "") as bar:
        whole, actions = run(pen_lock, seeds, Watched(), LABEL, tmp_path / "whole", bar)
        with pytest.raises(KeyboardInterrupt):
            run(pen_lock, seeds, Watched(killed_in=3), LABEL, tmp_path / "killed", bar)
        last = Watched()
        resumed, again = run(pen_lock, seeds, last, LABEL, tmp_path / "killed", bar)
    assert last.batches == [seeds[4:]]
    assert resumed == whole
    assert all(np.array_equal(actions[seed], again[seed]) for seed in seeds)


def test_limits_end_episodes_and_recorders_hear_of_it(expert, pen_lock):
    class Ends(Recorder):
        def start(self, lock, seeds):
            self.done, self.running = [], []

        def after(self, lock, step):
            self.running.append(step.running.tolist())
            self.done.append(np.flatnonzero(step.done).tolist())

    ends = Ends()
    roll(pen_lock, Mean(expert), SEEDS.evaluation.take(2), limits=np.array([1, 3]), recorders=[ends])
    assert ends.running == [[0, 1], [1], [1]] and ends.done == [[0], [], [1]]


# -- policies ------------------------------------------------------------------------------------


class Spy:
    """Remembers all that it is given, and returns the number of the step."""

    def __init__(self, actions: int = 39) -> None:
        self.seen: list[dict[str, np.ndarray]] = []
        self.actions = actions

    def start(self, tasks, goals, seeds):
        self.started = tasks, goals, seeds
        return 0

    def act(self, observations, memory):
        self.seen.append(observations)
        rows = len(next(iter(observations.values())))
        return np.full((rows, self.actions), 0.1 * memory, np.float32), memory + 1


class Constant:
    """An expert whose mean is -1 and whose samples are its generator's."""

    def mean(self, state):
        return np.full((len(state), 2), -1, np.float32)

    def sample(self, state, rng):
        return rng.standard_normal((len(state), 2)).astype(np.float32)


def acted(policy, steps: int, n: int = 2, seeds: tuple[int, ...] = (5, 6)) -> np.ndarray:
    """(steps, n, A)"""
    memory, actions = policy.start(np.zeros(n, np.int64), None, list(seeds)), []
    for _ in range(steps):
        action, memory = policy.act({"state": np.zeros((n, 3), np.float32)}, memory)
        actions.append(action)
    return np.stack(actions)


def test_noise_and_samples_may_share_one_stream():
    rng, same = np.random.default_rng(3), np.random.default_rng(3)
    found = acted(Noisy(Sampled(Constant(), rng), 0.1, rng), 2)
    for action in found:
        drawn = same.standard_normal((2, 2)).astype(np.float32)
        assert np.allclose(action, np.clip(drawn + 0.1 * same.standard_normal((2, 2)), -1, 1))
    assert found.dtype == np.float32


def test_offsets_and_a_first_action_count_steps():
    offsets = np.arange(12, dtype=np.float32).reshape(2, 3, 2) / 20
    assert np.allclose(acted(Offset(Spy(2), offsets), 3), np.arange(3)[:, None, None] / 10 + offsets.swapaxes(0, 1))
    first = np.full((2, 2), 0.7, np.float32)
    assert acted(FirstThen(first, Mean(Constant())), 3)[:, 0, 0].tolist() == pytest.approx([0.7, -1, -1])


def test_a_mixture_draws_for_each_episode_from_its_own_seed():
    def parts():
        return Mean(Constant()), Spy(2)

    by_first = acted(Mixture(*parts(), 0.5), 40)[:, :, 0] == -1
    assert 10 < by_first.sum(0).min() and by_first.sum(0).max() < 30
    swapped = acted(Mixture(*parts(), 0.5), 40, seeds=(6, 5))[:, :, 0] == -1
    assert np.array_equal(by_first, swapped[:, ::-1]) and not np.array_equal(by_first[:, 0], by_first[:, 1])
    never = Spy(2)
    acted(Mixture(never, Mean(Constant()), 0.0), 3)
    assert not never.seen


def test_too_many_episodes_for_a_padded_policy_are_refused():
    with pytest.raises(ValueError, match="3 episodes for a policy of 2 rows"):
        padded(np.zeros((3, 1)), 2)


def test_episodes_survive_json():
    episode = Episode(Label("none", PEN.name, "oracle", "own", "perturbed"), 7, True, False, True, 50, -1.1 / 3)
    assert Episode.from_json(episode.to_json()) == episode


def test_nominal_starts_are_not_counted_twice():
    assert len(seeds_of(PEN.model_copy(update={"start": "nominal"}), "evaluation", 6)) == 1
    assert len(seeds_of(TaskConfig(name="myo/pen-twirl-hard", start="nominal"), "evaluation", 6)) == 6
    assert seeds_of(PEN, "validation", 6) == SEEDS.validation.take(6)
    assert seeds_of(PEN, "evaluation", 6, offset=4) == SEEDS.evaluation.take(6, offset=4)


def test_success_rows_hold_every_rule_with_its_interval():
    episodes = [Episode(LABEL, seed, seed < 2, seed < 1, seed < 3, 50, float(seed)) for seed in range(4)]
    rows = success_rows(episodes)
    assert [(row["rule"], row["successes"], row["episodes"]) for row in rows] == [
        ("final", 2, 4),
        ("held", 1, 4),
        ("once", 3, 4),
    ]
    assert rows[0]["low"] == wilson(2, 4).low and rows[0]["mean_return"] == 1.5


# -- goals ---------------------------------------------------------------------------------------


def test_oracle_goals_keep_the_seeds_that_the_expert_fails(expert):
    seeds, lock = SEEDS.evaluation.take(3), Lockstep(PEN, 1, image_size=None)
    ends = [run_batch(lock, [seed], Padded(Mean(expert), 2), LABEL) for seed in seeds]
    assert not any(episodes[0].final for episodes, _ in ends)
    goals = oracle_goals(PEN, expert, seeds, 2, 48)
    env = registry.make(PEN, image_size=48)
    for seed, goal, (_, actions) in zip(seeds, goals, ends, strict=True):
        env.reset(seed=seed)
        for action in actions[:, 0]:
            obs, *_ = env.step(action)
        assert goal.shape == (48, 48, 3) and np.abs(goal.astype(int) - obs["image"]).max() <= 2


def test_training_goals_are_ends_of_demonstrations_chosen_by_seed(artifacts):
    seeds = SEEDS.evaluation.take(12)
    known = Demonstrations.load(artifacts["rollouts"][0], ["final_image"]).arrays["final_image"]
    goals = training_goals(artifacts["rollouts"][0], seeds)
    places = [next(i for i, image in enumerate(known) if np.array_equal(image, goal)) for goal in goals]
    assert places == [demonstration_for(seed, 3) for seed in seeds] and set(places) == {0, 1, 2}


# -- the student ---------------------------------------------------------------------------------


@pytest.mark.parametrize("shuffled", [False, True])
def test_the_student_sees_image_and_proprio_in_full_batches_and_nothing_else(shuffled):
    lock, spy, given = Lockstep(PEN, 3, image_size=32), Spy(), []
    seeds, goals = SEEDS.evaluation.take(2), np.arange(2, dtype=np.uint8)[:, None, None, None]
    policy = Restricted(Padded(spy, 3), STUDENT_ENTRIES)

    class Given(Recorder):
        def before(self, lock, step):
            given.append(step.observations)

    roll(lock, ShuffledImages(policy) if shuffled else policy, seeds, task=1, goals=goals, recorders=[Given()])
    tasks, goal_images, row_seeds = spy.started
    assert tasks.tolist() == [1, 1, 1] and goal_images.ravel().tolist() == [0, 1, 1] and row_seeds == [*seeds, seeds[1]]
    for obs, seen in zip(given, spy.seen, strict=True):
        assert set(obs) == {"image", "proprio", "state"} and set(seen) == {"image", "proprio"}
        assert np.array_equal(seen["proprio"], obs["proprio"][[0, 1, 1]])
        assert np.array_equal(seen["image"], obs["image"][[1, 0, 0] if shuffled else [0, 1, 1]])
    assert not np.array_equal(given[0]["image"][0], given[0]["image"][1])


def evaluation_request(condition: Condition = Condition(), seed: int = 5, **settings) -> EvaluationRequest:
    settings = {"episodes": 3, "lockstep": 2} | settings
    return EvaluationRequest(
        tasks=(PEN, HOLD),
        image=IMAGE,
        evaluation=EvaluationConfig(**settings),
        condition=condition,
        acting=ActingConfig(),
        seed=seed,
    )


def test_a_shuffled_image_needs_another_episode():
    with pytest.raises(ValueError, match="leave one alone"):
        evaluation_request(Condition(image_features="shuffled"), episodes=25, lockstep=8)


def test_only_goals_need_demonstrations_or_experts():
    used = {
        goal: [stage for stage in ("rollouts", "expert") if evaluation_request(Condition(goal=goal)).uses(stage)]
        for goal in ("training", "oracle", "commanded", "none")
    }
    assert used == {"training": ["rollouts"], "oracle": ["expert"], "commanded": [], "none": []}
    assert all(evaluation_request(Condition(goal=goal)).uses("student") for goal in used)


def untrained(folder: Path, owns_cnn: bool, history: int = 2, **imitation) -> Path:
    """The artifact of a student that has not been trained."""
    torch.manual_seed(0)
    settings = ACGDConfig(chunk=4, history=history, groups=2, codes=4, width=16, heads=2)
    sizes = Sizes(features=16, proprio=85, actions=39, tasks=2, owns_cnn=owns_cnn)
    made = new_student(settings, ImitationConfig(**imitation), sizes)
    weights = {"best": made.state_dict(), "last": made.state_dict()}
    save_student(made, folder, weights, {"tasks": [PEN.name, HOLD.name]})
    return folder


@pytest.fixture(scope="module")
def student(tmp_path_factory) -> Path:
    """An untrained student with its own CNN."""
    return untrained(tmp_path_factory.mktemp("student"), owns_cnn=True)


def test_acting_gives_a_student_the_inputs_of_its_training(artifacts, tmp_path, monkeypatch):
    """A replayed demonstration: history of proprio, features of image and goal, and task are those of Data.batch."""
    torch.manual_seed(1)
    backbone = SmallCNN(16).eval().requires_grad_(False)
    features = []
    for at, rollouts in enumerate(artifacts["rollouts"]):
        stored = Demonstrations.load(rollouts, ["image", "final_image"]).arrays
        seen = {name: backbone(torch.from_numpy(frames)).numpy() for name, frames in stored.items()}
        write_group(tmp_path / f"{at}/features.zarr", seen, {})
        features.append(tmp_path / f"{at}")
    folder = tmp_path / "student"
    folder.mkdir()
    untrained(folder, owns_cnn=False, history=3, goal="own")
    data = Data.load(
        {"rollouts": artifacts["rollouts"], "features": features},
        ImitationConfig(goal="own", label="executed"),
        chunk=4,
        history=3,
        states=False,
        device=torch.device("cpu"),
    )

    planned = []
    plan = ACGD.plan

    def spied(self, observation):
        planned.append(observation)
        return plan(self, observation)

    monkeypatch.setattr(ACGD, "plan", spied)
    monkeypatch.setattr("acgd.students.load.load_backbone", lambda folder, device: backbone)
    acting = load_policy(folder, tmp_path, ActingConfig(), torch.device("cpu"), rows=2)
    policy = Restricted(acting, STUDENT_ENTRIES)

    class Beside(Replay):
        """Replays, and lets the student act without effect."""

        def start(self, tasks, goals, seeds):
            self.memory = policy.start(tasks, goals, seeds)
            return super().start(tasks, goals, seeds)

        def act(self, observations, memory):
            _, self.memory = policy.act(observations, self.memory)
            return super().act(observations, memory)

    demos = Demonstrations.load(artifacts["rollouts"][1], ["action", "final_image"])
    lock = Lockstep(HOLD, 2, image_size=IMAGE.size)
    chosen = [2, 0]
    roll(
        lock,
        Beside(demos.arrays["action"], demos.episode_ends, lambda observations, seeds: chosen),
        demos.seeds[chosen].tolist(),
        task=acting.tasks.index(HOLD.name),
        goals=demos.arrays["final_image"][chosen],
    )
    first_row = len(Demonstrations.load(artifacts["rollouts"][0], ["action"]).arrays["action"])
    for row, episode in enumerate(chosen):
        t = torch.arange(demos.episode_starts[episode], demos.episode_ends[episode]) + first_row
        trained = data.batch(t, torch.Generator()).observation
        steps = planned[: len(t)]
        assert torch.equal(torch.stack([step.proprio[row] for step in steps]), trained.proprio)
        assert torch.equal(torch.stack([step.task[row] for step in steps]), trained.task)
        assert torch.allclose(torch.stack([step.vision[row] for step in steps]), trained.vision, atol=1e-4)
        assert torch.allclose(torch.stack([step.goal[row] for step in steps]), trained.goal, atol=1e-4)
        assert len(torch.unique(trained.vision, dim=0)) > 1


def same_files(a: Path, b: Path) -> bool:
    names = sorted(p.relative_to(a).as_posix() for p in a.rglob("*") if p.is_file())
    assert names == sorted(p.relative_to(b).as_posix() for p in b.rglob("*") if p.is_file())
    return filecmp.cmpfiles(a, b, names, shallow=False)[0] == names


def test_the_stages_evaluate_and_film_and_resume_to_the_same_bytes(artifacts, student, tmp_path, monkeypatch):
    inputs = {"student": student, "backbone": tmp_path, "rollouts": artifacts["rollouts"]}
    request = evaluation_request(seed_offset=7)
    evaluate(request, inputs, context(tmp_path / "whole"))
    out = tmp_path / "whole/out"
    episodes = read(out / "episodes.jsonl")
    assert [(e.label.goal, e.label.task, e.seed) for e in episodes] == [
        ("training", task.name, seed) for task in (PEN, HOLD) for seed in SEEDS.evaluation.take(3, offset=7)
    ]
    recorded = read_actions(out / "actions.safetensors")
    assert [(e.label.task, e.final) for e, _ in recorded] == [(PEN.name, False), (HOLD.name, False)]
    assert [e for e, _ in recorded] == [episodes[0], episodes[3]]
    assert all(len(actions) == e.steps for e, actions in recorded)

    for name in ("films", "again"):
        clips(ClipsRequest(tasks=(PEN, HOLD)), {"evaluation": out}, context(tmp_path / name))
    films = sorted((tmp_path / "films/out").glob("*.mp4"))
    assert [path.name for path in films] == ["myo-obj-hold-failure.mp4", "myo-pen-twirl-failure.mp4"]
    for path in films:
        frames, seconds = count_frames_and_secs(str(path))
        assert frames > 10 and seconds > 0.5
    assert same_files(tmp_path / "films/out", tmp_path / "again/out")

    from acgd.evaluation import evaluate as stage

    begun, whole_run = [], stage.run

    def killed(*args, **options):
        begun.append(args)
        if len(begun) == 2:
            raise KeyboardInterrupt
        return whole_run(*args, **options)

    monkeypatch.setattr(stage, "run", killed)
    with pytest.raises(KeyboardInterrupt):
        evaluate(request, inputs, context(tmp_path / "killed"))
    evaluate(request, inputs, context(tmp_path / "killed"))
    context(tmp_path / "killed").metrics.flush()
    assert same_files(out, tmp_path / "killed/out")


@pytest.mark.parametrize(
    "condition",
    [
        Condition(goal="oracle"),
        Condition(image_features="shuffled"),
        Condition(start="nominal"),
    ],
)
def test_every_condition_labels_its_episodes(artifacts, student, tmp_path, condition):
    inputs = {"student": student, "backbone": tmp_path, **artifacts}
    evaluate(evaluation_request(condition, episodes=2), inputs, context(tmp_path))
    labels = {e.label for e in read(tmp_path / "out/episodes.jsonl")}
    start = condition.start or "perturbed"
    assert labels == {Label("none", task.name, condition.goal, condition.image_features, start) for task in (PEN, HOLD)}


def test_a_shuffled_image_of_the_only_nominal_start_is_refused(artifacts, student, tmp_path):
    inputs = {"student": student, "backbone": tmp_path, **artifacts}
    request = evaluation_request(Condition(image_features="shuffled", start="nominal"), episodes=2)
    with pytest.raises(ValueError, match="leave out start: nominal"):
        evaluate(request, inputs, context(tmp_path))


def test_an_on_policy_round_of_a_student(artifacts, student, tmp_path):
    """What the student does in a round is what it does from the same seeds in an evaluation."""
    request = OnPolicyRequest(
        task=HOLD,
        image=IMAGE,
        acting=ActingConfig(),
        rounds=RoundsConfig(episodes=3, beta=0.0),
        round=1,
        seed=2,
    )
    inputs = {"student": student, "backbone": tmp_path, "rollouts": artifacts["rollouts"][1]}
    collect_on_policy(request, inputs | {"expert": artifacts["expert"][1]}, context(tmp_path))
    found = Demonstrations.load(tmp_path / "out", ["action", "image", "mean_action", "by_expert"])
    seeds = round_seeds(2, 1, 3)
    assert found.seeds.tolist() == seeds and not found.arrays["by_expert"].any()
    acting = load_policy(student, tmp_path, ActingConfig(), torch.device("cpu"), rows=onpolicy.LOCKSTEP)
    recorder, goals = Episodes(), training_goals(artifacts["rollouts"][1], seeds)
    roll(Lockstep(HOLD, 3, image_size=IMAGE.size), acting, seeds, task=1, goals=goals, recorders=[recorder])
    for name in ("action", "image"):
        expected = np.concatenate([episode[name] for episode in recorder.episodes()])
        assert np.array_equal(found.arrays[name], expected)


# -- controls ------------------------------------------------------------------------------------


def test_replay_repeats_the_demonstration_and_then_its_last_action():
    actions = np.arange(10, dtype=np.float32)[:, None]
    policy = Replay(actions, np.array([4, 10]), lambda observations, seeds: [1, 0])
    assert acted(policy, 8)[:, :, 0].tolist() == [[4, 0], [5, 1], [6, 2], [7, 3], [8, 3], [9, 3], [9, 3], [9, 3]]


def test_replay_from_the_demonstrations_own_start_ends_as_it_did(artifacts, pen_lock):
    """Nearest to the start of a demonstration is the demonstration itself."""
    demonstrations = Demonstrations.load(artifacts["rollouts"][0], ["action", "state"])
    episodes, actions = run_batch(pen_lock, demonstrations.seeds[:2].tolist(), replay_nearest(demonstrations), LABEL)
    assert [e.steps for e in episodes] == demonstrations.lengths[:2].tolist()
    assert np.array_equal(actions[0], demonstrations.arrays["action"][demonstrations.episode_starts[:2]])


def test_blind_replay_reads_no_observation(artifacts):
    demonstrations = Demonstrations.load(artifacts["rollouts"][0], ["action"])
    policy = replay(demonstrations)
    action, _ = policy.act({}, policy.start(np.zeros(2, np.int64), None, [8, 9]))
    chosen = [demonstration_for(seed, 3) for seed in (8, 9)]
    assert np.array_equal(action, demonstrations.arrays["action"][demonstrations.episode_starts[chosen]])


def test_nearest_weighs_entries_by_their_spread():
    starts = np.array([[0.0, 0.0, 5.0], [1.0, 100.0, 5.0]])
    states = np.array([[0.9, 20.0, 9.0], [0.9, 80.0, 9.0], [0.1, 45.0, -9.0]])
    assert nearest(states, starts).tolist() == [1, 1, 0]


def test_controls_pair_with_the_evaluation(artifacts, tmp_path):
    request = ControlsRequest(tasks=(PEN, HOLD), controls=ControlsConfig(episodes=3, lockstep=2, seed_offset=7))
    for name in ("first", "second"):
        controls(request, dict(artifacts), context(tmp_path / name))
    episodes = read(tmp_path / "first/out/episodes.jsonl")
    for task in (PEN, HOLD):
        for control in CONTROLS:
            seeds = [e.seed for e in episodes if e.label.control == control and e.label.task == task.name]
            assert seeds == SEEDS.evaluation.take(1 if control == "expert-nominal" else 3, offset=7)
    assert same_files(tmp_path / "first/out", tmp_path / "second/out")


# -- clips ---------------------------------------------------------------------------------------


def test_clips_are_playable_and_repeat_byte_for_byte(tmp_path):
    frames = np.zeros((30, 252, 252, 3), np.uint8)
    for i, frame in enumerate(frames):
        frame[:, : 8 * i] = (220, 40, 40)
    for name in ("a", "b"):
        write_mp4(tmp_path / f"{name}.mp4", frames, 25.0)
    assert filecmp.cmp(tmp_path / "a.mp4", tmp_path / "b.mp4", shallow=False)
    played = read_frames(str(tmp_path / "a.mp4"))
    about = next(played)
    shown = [np.frombuffer(frame, np.uint8).reshape(252, 252, 3) for frame in played]
    assert about["size"] == (252, 252) and about["fps"] == 25.0 and len(shown) == 30
    assert np.abs(shown[20].astype(int) - frames[20]).mean() < 8


def test_a_clip_of_another_outcome_is_refused(tmp_path):
    episode = Episode(LABEL, SEEDS.evaluation.take(1)[0], True, True, True, 3, 0.0)
    with pytest.raises(RuntimeError, match="does not repeat"):
        film(tmp_path / "never.mp4", registry.make(PEN, image_size=None), episode, np.zeros((3, 39), np.float32))
    assert not (tmp_path / "never.mp4").exists()


def test_padding_repeats_the_last_row():
    assert padded(np.array([[1], [2]]), 4).ravel().tolist() == [1, 2, 2, 2]
