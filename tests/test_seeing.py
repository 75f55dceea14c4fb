"""Earlier frames and commanded goals, for every kind of student: read in training as when acting."""

import numpy as np
import pytest
import synthetic
import torch
from torch import Tensor

from acgd.rollouts.dataset import Demonstrations
from acgd.rollouts.store import write_group
from acgd.store.stage import Inputs
from acgd.students.acgd.fit_codebook import fit
from acgd.students.data import Data, Observation
from acgd.students.distil import distil
from acgd.students.inputs import GoalNormaliser, StudentInputs
from acgd.students.kinds import STUDENTS
from acgd.students.load import load_student, new_student, policy_of, sizes_of
from acgd.students.settings import ActingConfig, ImitationConfig
from acgd.students.student import Sizes, Student

CPU = torch.device("cpu")
WAYS = [{"frames": 3, "frame_stride": 2}, {"goal": "vector"}, {"frames": 2, "goal": "vector"}]

every_student = pytest.mark.parametrize("kind", STUDENTS)


class Corners(torch.nn.Module):
    """A backbone that tells frames apart: six pixels of an image."""

    def forward(self, images: Tensor) -> Tensor:
        return images[:, :2, 0].flatten(1).float()


@pytest.fixture(scope="module")
def inputs(tmp_path_factory) -> Inputs:
    """Rollouts of two tasks, with goals of two and three numbers, and their features by Corners."""
    folder = tmp_path_factory.mktemp("seen")
    places = [synthetic.rollouts(folder / f"rollouts-{i}", i, episodes=4, images=True) for i in range(2)]
    features = []
    for place in places:
        frames = Demonstrations.load(place, ["image", "final_image"]).arrays
        features.append(folder / f"features-{len(features)}")
        encoded = {name: Corners()(torch.from_numpy(value)).numpy() for name, value in frames.items()}
        write_group(features[-1] / "features.zarr", encoded, {})
    return {"rollouts": places, "features": features}


def loaded(inputs: Inputs, kind: str, **imitation) -> Data:
    settings = synthetic.student_request(kind).student
    imitation = ImitationConfig(**imitation)
    return Data.load(
        inputs,
        imitation,
        chunk=settings.chunk,
        history=settings.history,
        states=False,
        device=CPU,
        recurrent=settings.recurrent,
    )


def shown(student: Student) -> list[Observation]:
    """Fills with what the student's inputs are given."""
    observations: list[Observation] = []
    (inputs,) = (part for part in student.modules() if isinstance(part, StudentInputs))
    inputs.register_forward_pre_hook(lambda _, given: observations.append(given[0]))
    return observations


def test_a_window_holds_its_frame_and_those_before_oldest_first(inputs):
    one, data = loaded(inputs, "bc"), loaded(inputs, "bc", frames=3, frame_stride=2)
    windows = data.windows
    start = int(windows.start[-1])
    t = torch.tensor([start, start + 1, start + 3, start + 9])
    vision = data.batch(t, torch.Generator()).observation.vision.unflatten(-1, (3, -1))
    for row, steps in zip(vision, [(0, 0, 0), (0, 0, 1), (0, 1, 3), (5, 7, 9)]):
        assert torch.equal(row, one.windows.steps["vision"][start + torch.tensor(steps)])


def test_each_step_of_a_recurrent_window_holds_its_own_earlier_frames(inputs):
    one, data = loaded(inputs, "bc"), loaded(inputs, "bc_rnn", frames=3, frame_stride=2)
    start, end = (int(bound[-1]) for bound in (data.windows.start, data.windows.end))
    t = torch.tensor([start, end - 2])
    observation = data.batch(t, torch.Generator()).observation
    steps = torch.stack([start + torch.arange(4), end - torch.tensor([2, 1, 1, 1])])
    for j in range(4):
        frames = torch.stack([steps[:, j] - 4, steps[:, j] - 2, steps[:, j]], dim=-1).clamp(min=start)
        assert torch.equal(observation.vision[:, j].unflatten(-1, (3, -1)), one.windows.steps["vision"][frames])
    assert torch.equal(observation.proprio, data.windows.steps["proprio"][steps])


@every_student
@pytest.mark.parametrize("imitation", WAYS, ids=str)
def test_what_acts_sees_what_was_trained(kind, imitation, inputs):
    """Two episodes of unequal length side by side; the last window of each is at another time."""
    data = loaded(inputs, kind, **imitation | {"goal": imitation.get("goal", "own")})
    student = new_student(synthetic.student_request(kind).student, data.imitation, sizes_of(data, inputs))
    observations = shown(student)
    policy = policy_of(student, Corners(), ActingConfig(), tasks=synthetic.TASKS, rows=3)
    demos = Demonstrations.load(inputs["rollouts"][1], ["image", "proprio", "final_image", "goal"])
    goals = demos.arrays["goal" if data.imitation.goal == "vector" else "final_image"][:2]
    memory = policy.start(np.array([1, 1]), goals, [0, 1])
    for t in range(10):
        rows = demos.episode_starts[:2] + t
        _, memory = policy.act({name: demos.arrays[name][rows] for name in ("image", "proprio")}, memory)
        steps = torch.from_numpy(rows) + int((data.windows.task == 0).sum())
        expected = data.batch(steps, torch.Generator()).observation
        for name in ("vision", "goal", "task"):
            seen, trained = getattr(observations[-1], name)[:2], getattr(expected, name)
            if seen.ndim == 3:  # of a recurrent kind: one observation at a time
                seen, trained = seen[:, 0], trained[:, 0]
            assert torch.equal(seen, trained), (t, name)


@every_student
@pytest.mark.parametrize("imitation", WAYS[::2], ids=str)
def test_every_student_trains_and_loads(kind, imitation, inputs, tmp_path):
    given = dict(inputs)
    if kind == "acgd":
        ctx = synthetic.context(tmp_path / "codebook")
        fit(synthetic.codebook_request(imitation=imitation), given, ctx)
        given["codebook"] = ctx.out
    ctx = synthetic.context(tmp_path / "student")
    distil(synthetic.student_request(kind, imitation=imitation), given, ctx)
    student = load_student(ctx.out, "last", CPU)
    policy = policy_of(student, Corners(), ActingConfig(), tasks=synthetic.TASKS, rows=2)
    goals = np.zeros((2, 2), np.float32) if "goal" in imitation else np.zeros((2, 32, 32, 3), np.uint8)
    memory = policy.start(np.array([0, 0]), goals, [0, 1])
    seen = {"image": np.zeros((2, 32, 32, 3), np.uint8), "proprio": np.zeros((2, synthetic.P), np.float32)}
    actions, _ = policy.act(seen, memory)
    assert actions.shape == (2, synthetic.A) and np.isfinite(actions).all()


def test_a_commanded_goal_is_normalised_by_its_own_task(inputs):
    data = loaded(inputs, "bc", goal="vector")
    goals, task = data.windows.episodes["goal"], data.windows.episode_task
    assert goals.shape == (8, 3) and (goals[task == 0, 2] == 0).all()
    normaliser = GoalNormaliser(2, 3)
    normaliser.fit(1e-3 * goals + 100 * task[:, None], task)
    normal = normaliser(1e-3 * goals + 100 * task[:, None], task)
    assert torch.allclose(normal[task == 1].std(0, correction=0), torch.ones(3), atol=0.05)
    assert (normal[task == 0, 2] == 0).all()


def test_an_on_policy_episode_that_failed_has_its_commanded_goal(inputs):
    data = loaded(
        inputs | {"onpolicy": inputs["rollouts"], "onpolicy_features": inputs["features"]}, "bc", goal="vector"
    )
    t = data.windows.training
    goal = data.batch(t, torch.Generator()).observation.goal
    assert torch.equal(goal, data.windows.episodes["goal"][data.windows.episode[t]])


def test_a_student_that_owns_its_cnn_reads_one_frame(inputs, tmp_path):
    without = {"rollouts": inputs["rollouts"], "backbone": synthetic.backbone(tmp_path / "backbone")}
    with pytest.raises(ValueError, match="Set imitation.frames to 1"):
        sizes_of(loaded(without, "bc", frames=2), without)
    data = loaded(without, "bc", goal="vector")
    assert (
        sizes_of(data, without).goal == 3
        and data.batch(torch.tensor([0]), torch.Generator()).observation.goal.ndim == 2
    )


@pytest.mark.parametrize(
    ("goal", "given", "mend"),
    [
        ("vector", None, "Give commanded goals"),
        ("vector", np.zeros((1, 4, 4, 3), np.uint8), "imitation.goal: vector"),
        ("any", np.zeros((1, 3), np.float32), "imitation.goal: any"),
    ],
)
def test_a_goal_of_another_kind_is_refused(goal, given, mend):
    settings = synthetic.student_request("bc").student
    sizes = Sizes(features=6, proprio=synthetic.P, actions=synthetic.A, tasks=1, owns_cnn=False, goal=3)
    student = new_student(settings, ImitationConfig(goal=goal), sizes)
    policy = policy_of(student, Corners(), ActingConfig(), tasks=["myo/reach"], rows=1)
    with pytest.raises(ValueError, match=mend):
        policy.start(np.zeros(1, np.int64), given, [0])
