"""Evaluation: episodes that depend on nothing but their seed, controls, goals, clips."""

import filecmp
import io
from pathlib import Path

import numpy as np
import pytest
import torch
from imageio_ffmpeg import count_frames_and_secs, read_frames

from acgd.evaluation.clips import film, filming, write_mp4
from acgd.evaluation.controls import CONTROLS, controls, nearest, replay
from acgd.evaluation.episodes import Episode, Label, expert_policy, padded, read, roll, run, seeds_of
from acgd.evaluation.evaluate import StudentPolicy, evaluate, plan
from acgd.evaluation.goals import demonstration_for, oracle_goals, training_goals
from acgd.evaluation.settings import Condition, ControlsConfig, ControlsRequest, EvaluationConfig, EvaluationRequest
from acgd.evaluation.summary import success_rows
from acgd.experts.policy import Expert
from acgd.rollouts.dataset import Demonstrations
from acgd.rollouts.store import write_group
from acgd.simulate.lockstep import Lockstep
from acgd.simulate.proportion import wilson
from acgd.simulate.seeds import SEEDS
from acgd.store.metrics import Metrics
from acgd.store.progress import Progress
from acgd.store.stage import Context
from acgd.students.codebook import Sizes
from acgd.students.settings import CodebookConfig
from acgd.students.student import Student
from acgd.tasks import registry
from acgd.tasks.settings import TaskConfig

PEN = TaskConfig(name="myo/pen-twirl")
"""The shortest episodes: 50 steps at most."""
HOLD = TaskConfig(name="myo/obj-hold")
LABEL = Label("expert", PEN.name, "none", "none", "perturbed")


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
    found = {"rollouts": [], "experts": []}
    for task in (PEN, HOLD):
        acts = random_expert(task)
        lock = Lockstep(task, 3, image_size=84)
        states: list[np.ndarray] = []

        def policy(obs, step, acts=acts, states=states):
            states.append(obs["state"])
            return acts.mean(obs["state"])

        episodes, actions = roll(lock, SEEDS.demonstrations.take(3), policy, LABEL)
        lengths = [e.steps for e in episodes]
        arrays = {
            "action": np.concatenate([actions[:n, i] for i, n in enumerate(lengths)]),
            "state": np.concatenate([np.stack(states)[:n, i] for i, n in enumerate(lengths)]),
            "final_image": np.stack([env.render() for env in lock.envs]),
            "episode_ends": np.cumsum(lengths).astype(np.int64),
            "seed": np.array(SEEDS.demonstrations.take(3), np.int64),
        }
        place = folder / task.name.replace("/", "-")
        (place / "expert").mkdir(parents=True)
        write_group(place / "rollouts.zarr", arrays, {"task": task.name, "reward_terms": [], "state_layout": {}})
        acts.save(place / "expert")
        found["rollouts"].append(place)
        found["experts"].append(place / "expert")
    return found


# -- episodes ------------------------------------------------------------------------------------


def test_lockstep_equals_one_after_the_other(expert):
    """With actions that do not depend on the batch, each seed ends the same to the last bit, beside others or alone."""
    seeds = SEEDS.evaluation.take(3)
    rng = np.random.default_rng(0)
    actions = rng.uniform(-1, 0, (50, 3, 39)).astype(np.float32)
    together, _ = roll(Lockstep(PEN, 3, image_size=None), seeds, lambda obs, t: actions[t], LABEL)
    lock = Lockstep(PEN, 1, image_size=None)
    alone = [
        roll(lock, [seed], lambda obs, t, i=i: actions[t, i : i + 1], LABEL)[0][0]
        for i, seed in reversed(list(enumerate(seeds)))
    ]
    assert together == alone[::-1]
    assert len({e.reward for e in together}) == 3


def test_an_episode_does_not_depend_on_how_many_there_are(expert, tmp_path):
    """Fixed batches: the first three of five are the three of three, though their last batch is only half full."""
    seeds, lock = SEEDS.evaluation.take(5), Lockstep(PEN, 2, image_size=None)
    with Progress(io.StringIO())(8, "") as bar:
        five, _ = run(lock, seeds, lambda batch: expert_policy(expert, 2), LABEL, tmp_path / "five", bar)
        three, _ = run(lock, seeds[:3], lambda batch: expert_policy(expert, 2), LABEL, tmp_path / "three", bar)
    assert five[:3] == three


def test_a_resumed_run_equals_an_uninterrupted_one(expert, pen_lock, tmp_path):
    seeds, asked = SEEDS.validation.take(5), []

    def policy_for(batch, dies=False):
        asked.append(batch)
        if dies and len(asked) == 3:
            raise KeyboardInterrupt
        return expert_policy(expert, 2)

    with Progress(io.StringIO())(15, "") as bar:
        whole, actions = run(pen_lock, seeds, policy_for, LABEL, tmp_path / "whole", bar)
        asked.clear()
        with pytest.raises(KeyboardInterrupt):
            run(pen_lock, seeds, lambda batch: policy_for(batch, dies=True), LABEL, tmp_path / "killed", bar)
        asked.clear()
        resumed, again = run(pen_lock, seeds, policy_for, LABEL, tmp_path / "killed", bar)
    assert asked == [seeds[4:]]
    assert resumed == whole
    assert all(np.array_equal(actions[seed], again[seed]) for seed in seeds)


def test_episodes_survive_json():
    episode = Episode(Label("none", PEN.name, "oracle", "own", "perturbed"), 7, True, False, True, 50, -1.1 / 3)
    assert Episode.from_json(episode.to_json()) == episode


def test_nominal_starts_are_not_counted_twice():
    assert len(seeds_of(PEN.model_copy(update={"start": "nominal"}), "evaluation", 6)) == 1
    assert len(seeds_of(TaskConfig(name="myo/pen-twirl-hard", start="nominal"), "evaluation", 6)) == 6
    assert seeds_of(PEN, "validation", 6) == SEEDS.validation.take(6)


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
    ends = [roll(lock, [seed], expert_policy(expert, 2), LABEL) for seed in seeds]
    assert not any(episodes[0].final for episodes, _ in ends)
    goals = oracle_goals(PEN, expert, seeds, 2)
    env = registry.make(PEN)
    for seed, goal, (_, actions) in zip(seeds, goals, ends, strict=True):
        env.reset(seed=seed)
        for action in actions[:, 0]:
            obs, *_ = env.step(action)
        assert goal.shape == (84, 84, 3) and np.abs(goal.astype(int) - obs["image"]).max() <= 2


def test_training_goals_are_ends_of_demonstrations_chosen_by_seed(artifacts):
    seeds = SEEDS.evaluation.take(12)
    known = Demonstrations.load(artifacts["rollouts"][0], ["final_image"]).arrays["final_image"]
    goals = training_goals(artifacts["rollouts"][0], seeds)
    places = [next(i for i, image in enumerate(known) if np.array_equal(image, goal)) for goal in goals]
    assert places == [demonstration_for(seed, 3) for seed in seeds] and set(places) == {0, 1, 2}


# -- the student ---------------------------------------------------------------------------------


class SpyActor:
    """Remembers all that it is given."""

    def __init__(self) -> None:
        self.seen: list[dict[str, np.ndarray]] = []

    def reset(self, task_ids, goal_images, seeds):
        self.started = task_ids, goal_images, seeds
        return 0

    def act(self, obs, memory):
        self.seen.append(obs)
        return np.full((len(obs["image"]), 39), -0.5, np.float32), memory + 1


@pytest.mark.parametrize("shuffled", [False, True])
def test_the_student_sees_image_and_proprio_in_full_batches_and_nothing_else(shuffled):
    lock, spy, given = Lockstep(PEN, 3, image_size=84), SpyActor(), []
    seeds, goals = SEEDS.evaluation.take(2), np.arange(2, dtype=np.uint8)[:, None, None, None]
    policy = StudentPolicy(spy, 1, seeds, goals, 3, shuffled=shuffled)

    def watched(obs, step):
        given.append(obs)
        return policy(obs, step)

    roll(lock, seeds, watched, LABEL)
    task_ids, goal_images, row_seeds = spy.started
    assert (
        task_ids.tolist() == [1, 1, 1] and goal_images.ravel().tolist() == [0, 1, 1] and row_seeds == [*seeds, seeds[1]]
    )
    for obs, seen in zip(given, spy.seen, strict=True):
        assert set(obs) == {"image", "proprio", "state"} and set(seen) == {"image", "proprio"}
        assert np.array_equal(seen["proprio"], obs["proprio"][[0, 1, 1]])
        assert np.array_equal(seen["image"], obs["image"][[1, 0, 0] if shuffled else [0, 1, 1]])
    assert not np.array_equal(given[0]["image"][0], given[0]["image"][1])


def test_conditions_that_the_student_cannot_tell_apart_run_once():
    conditions = (
        Condition(),
        Condition(image_features="shuffled"),
        Condition(goal="oracle"),
        Condition(start="nominal"),
    )
    request = EvaluationRequest(tasks=(PEN, HOLD), evaluation=EvaluationConfig(episodes=4, conditions=conditions))
    with_goal, without = plan(request, uses_goal=True), plan(request, uses_goal=False)
    assert len(with_goal) == 8 and [r.label.goal for r in with_goal[::2]] == [
        "training",
        "training",
        "oracle",
        "training",
    ]
    assert len(without) == 6 and {r.label.goal for r in without} == {"none"}
    assert [r.place for r in without] == [0, 1] * 3
    assert [len(r.seeds) for r in with_goal[-2:]] == [1, 1]


def test_a_shuffled_image_needs_another_episode():
    with pytest.raises(ValueError, match="leave one alone"):
        EvaluationConfig(episodes=25, lockstep=8, conditions=(Condition(image_features="shuffled"),))


@pytest.fixture(scope="module")
def student(tmp_path_factory) -> Path:
    """An untrained student with its own CNN."""
    folder = tmp_path_factory.mktemp("student")
    torch.manual_seed(0)
    config = CodebookConfig(
        chunk=4, history=2, groups=2, codes=4, width=16, heads=2, encoder_layers=1, decoder_layers=1
    )
    made = Student(config, Sizes(features=16, proprio=85, actions=39, tasks=2, owns_cnn=True))
    made.save(folder, {"best": made.state_dict()}, {})
    return folder


def same_files(a: Path, b: Path) -> bool:
    names = sorted(p.relative_to(a).as_posix() for p in a.rglob("*") if p.is_file())
    assert names == sorted(p.relative_to(b).as_posix() for p in b.rglob("*") if p.is_file())
    return filecmp.cmpfiles(a, b, names, shallow=False)[0] == names


def test_the_stage_evaluates_films_and_resumes_to_the_same_bytes(artifacts, student, tmp_path, monkeypatch):
    settings = EvaluationConfig(episodes=3, lockstep=2, conditions=(Condition(), Condition(goal="oracle")))
    request = EvaluationRequest(tasks=(PEN, HOLD), evaluation=settings, seed=5)
    inputs = {"student": student, **artifacts}
    evaluate(request, inputs, context(tmp_path / "whole"))

    episodes = read(tmp_path / "whole/out/episodes.jsonl")
    assert [(e.label.goal, e.label.task, e.seed) for e in episodes] == [
        (goal, task.name, seed)
        for goal in ("training", "oracle")
        for task in (PEN, HOLD)
        for seed in SEEDS.evaluation.take(3)
    ]
    clips = sorted((tmp_path / "whole/out/clips").iterdir())
    assert [c.name for c in clips] == ["myo-obj-hold-failure.mp4", "myo-pen-twirl-failure.mp4"]
    for clip in clips:
        frames, seconds = count_frames_and_secs(str(clip))
        assert frames > 10 and seconds > 0.5

    from acgd.evaluation import evaluate as stage

    done, film_both = [], stage.film_both

    def killed(*args):
        done.append(args)
        if len(done) == 2:
            raise KeyboardInterrupt
        film_both(*args)

    monkeypatch.setattr(stage, "film_both", killed)
    with pytest.raises(KeyboardInterrupt):
        evaluate(request, inputs, context(tmp_path / "killed"))
    evaluate(request, inputs, context(tmp_path / "killed"))
    context(tmp_path / "killed").metrics.flush()
    assert same_files(tmp_path / "whole/out", tmp_path / "killed/out")


# -- controls ------------------------------------------------------------------------------------


def test_replay_repeats_the_demonstration_and_then_its_last_action(artifacts):
    demonstrations = Demonstrations.load(artifacts["rollouts"][0], ["action"])
    start, end = demonstrations.episode_starts[1], demonstrations.episode_ends[1]
    policy = replay(demonstrations, [1, 0])
    assert np.array_equal(policy({}, 3)[0], demonstrations.arrays["action"][start + 3])
    assert np.array_equal(policy({}, 10_000)[0], demonstrations.arrays["action"][end - 1])


def test_replay_from_the_demonstrations_own_start_ends_as_it_did(artifacts, pen_lock):
    demonstrations = Demonstrations.load(artifacts["rollouts"][0], ["action"])
    episodes, _ = roll(pen_lock, demonstrations.seeds[:2].tolist(), replay(demonstrations, [0, 1]), LABEL)
    assert [e.steps for e in episodes] == demonstrations.lengths[:2].tolist()


def test_nearest_weighs_entries_by_their_spread():
    starts = np.array([[0.0, 0.0, 5.0], [1.0, 100.0, 5.0]])
    states = np.array([[0.9, 20.0, 9.0], [0.9, 80.0, 9.0], [0.1, 45.0, -9.0]])
    assert nearest(states, starts).tolist() == [1, 1, 0]


def test_controls_pair_with_the_evaluation(artifacts, tmp_path):
    request = ControlsRequest(tasks=(PEN, HOLD), controls=ControlsConfig(episodes=3, lockstep=2))
    for name in ("first", "second"):
        controls(request, dict(artifacts), context(tmp_path / name))
    episodes = read(tmp_path / "first/out/episodes.jsonl")
    for task in (PEN, HOLD):
        for control in CONTROLS:
            seeds = [e.seed for e in episodes if e.label.control == control and e.label.task == task.name]
            assert seeds == SEEDS.evaluation.take(1 if control == "expert-nominal" else 3)
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
        film(tmp_path / "never.mp4", filming(PEN), episode, np.zeros((3, 39), np.float32))
    assert not (tmp_path / "never.mp4").exists()


def test_padding_repeats_the_last_row():
    assert padded(np.array([[1], [2]]), 4).ravel().tolist() == [1, 2, 2, 2]
