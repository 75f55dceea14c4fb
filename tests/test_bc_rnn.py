"""The recurrent student: its mixture, its windows, its memory. The contracts of every kind are in test_students.py."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import synthetic
import torch
from torch import Tensor

from acgd.critics.aggregate import AggregateCritic
from acgd.guidance.critic.guidance import CriticGuidance
from acgd.nn.excitation import stretched_excitation
from acgd.nn.q_ensemble import Critic
from acgd.students.bc_rnn.mixture import Mixture, MixtureHead
from acgd.students.bc_rnn.model import BCRNN
from acgd.students.data import Data, Observation
from acgd.students.distil import start
from acgd.students.settings import ActingConfig, ImitationConfig

CPU = torch.device("cpu")
STATES = (9, 12)


def generator(seed: int = 0) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def streams() -> dict[str, torch.Generator]:
    return {"data": generator(1), "sample": generator(2)}


@pytest.fixture(scope="module")
def data(tmp_path_factory) -> Data:
    root = tmp_path_factory.mktemp("rollouts")
    rollouts = [synthetic.rollouts(root / str(i), i, state=STATES[i]) for i in range(2)]
    inputs = {"rollouts": rollouts, "features": rollouts}
    options = {"chunk": 4, "history": 1, "states": True, "recurrent": True}
    return Data.load(inputs, ImitationConfig(), device=CPU, **options)


def student_of(data: Data, **settings) -> BCRNN:
    """Untrained, with weights large enough for its memory to matter."""
    student = start(synthetic.student_request("bc_rnn", **settings), data, {"features": ()}, CPU)
    with torch.no_grad():
        for parameter in student.parameters():
            parameter.mul_(3)
    return student


def window(data: Data, t: int, steps: int, goal: Tensor) -> Observation:
    """The observations of t .. t + steps - 1."""
    vision, proprio = (data.windows.steps[name][None, t : t + steps] for name in ("vision", "proprio"))
    return Observation(vision, goal, proprio, data.windows.task[t : t + 1])


def acted(student: BCRNN, observations: list[Observation]) -> np.ndarray:
    """What the policy does, a row for each of the windows, (n, L, A)."""
    policy = student.policy(ActingConfig())
    tasks, goals = (np.concatenate([getattr(o, name).numpy() for o in observations]) for name in ("task", "goal"))
    memory, taken = policy.start(tasks, goals, [0] * len(tasks)), []
    for step in range(observations[0].proprio.shape[1]):
        obs = {
            "vision": np.concatenate([o.vision[:, step].numpy() for o in observations]),
            "proprio": np.concatenate([o.proprio[:, step].numpy() for o in observations]),
        }
        actions, memory = policy.act(obs, memory)
        taken.append(actions)
    return np.stack(taken, axis=1)


# --- the mixture ----------------------------------------------------------------------------------------------


def test_log_likelihood_by_hand():
    mixture = Mixture(
        means=torch.tensor([[[0.0, 0.5], [-0.5, 0.2]]]),
        stds=torch.tensor([[[0.1, 0.2], [0.3, 0.5]]]),
        logits=torch.log(torch.tensor([[0.25, 0.75]])),
    )

    def normal(x: float, mean: float, std: float) -> float:
        return math.exp(-0.5 * ((x - mean) / std) ** 2) / (std * math.sqrt(2 * math.pi))

    expected = 0.25 * normal(0.1, 0.0, 0.1) * normal(0.4, 0.5, 0.2) + 0.75 * normal(0.1, -0.5, 0.3) * normal(
        0.4, 0.2, 0.5
    )
    action = torch.tensor([[0.1, 0.4]])
    assert mixture.log_likelihood(action).tolist() == pytest.approx([math.log(expected)], rel=1e-5)


def test_log_likelihood_compares_excitations_where_it_is_told_to():
    mean, action = torch.tensor([[[0.3]]]), torch.tensor([[0.7]])
    mixture = Mixture(mean, torch.full((1, 1, 1), 0.2), torch.zeros(1, 1))
    stretched = Mixture(stretched_excitation(mean), mixture.stds, mixture.logits)
    expected = stretched.log_likelihood(stretched_excitation(action))
    assert torch.allclose(mixture.log_likelihood(action, "excitation"), expected)
    assert not torch.allclose(mixture.log_likelihood(action), expected)


def test_the_likeliest_mode_acts_and_a_gradient_reaches_its_mean_and_all_weights():
    means = torch.tensor([[0.1, -0.4], [0.6, 0.2], [-0.3, 0.9]], requires_grad=True)
    logits = torch.log(torch.tensor([0.2, 0.5, 0.3])).requires_grad_()
    action = Mixture(means, torch.ones(3, 2), logits).likeliest()
    assert torch.equal(action, means[1])
    by_means, by_logits = torch.autograd.grad(action @ torch.tensor([1.0, 0.0]), (means, logits))
    assert by_means.tolist() == [[0, 0], [1, 0], [0, 0]]
    # softmax backward: w_m (mu_m - sum_j w_j mu_j), of the first action component
    average = 0.2 * 0.1 + 0.5 * 0.6 - 0.3 * 0.3
    assert by_logits.tolist() == pytest.approx([0.2 * (0.1 - average), 0.5 * (0.6 - average), 0.3 * (-0.3 - average)])


def test_means_stay_in_the_box_and_no_standard_deviation_falls_below_the_least():
    head = MixtureHead(width=3, actions=2, modes=4, least_std=0.05)
    with torch.no_grad():
        head.stds.bias.fill_(-50.0)
    mixture = head(torch.randn(6, 5, 3, generator=generator()))
    assert mixture.means.shape == mixture.stds.shape == (6, 5, 4, 2) and mixture.logits.shape == (6, 5, 4)
    assert mixture.means.abs().max() < 1 and torch.allclose(mixture.stds, torch.tensor(0.05))


# --- windows --------------------------------------------------------------------------------------------------


def test_a_window_has_the_observation_of_each_of_its_actions(data):
    windows = data.windows
    t = torch.cat([windows.training[[0, 3, 11]], windows.end[windows.training[:1]] - 2])
    batch = data.batch(t, generator())
    assert batch.observation.vision.shape == (4, 4, synthetic.F) and batch.mask[3].tolist() == [
        True,
        True,
        False,
        False,
    ]
    for j in range(data.k):
        at = torch.minimum(t + j, windows.end[t] - 1)
        assert torch.equal(batch.observation.vision[:, j], windows.steps["vision"][at])
        assert torch.equal(batch.observation.proprio[:, j], windows.steps["proprio"][at])
        assert torch.equal(batch.chunk[:, j], windows.steps["label"][at])
        assert torch.equal(data.reference(batch).states[:, j], windows.steps["state"][at])
    # synthetic proprio[0] is the step / 10: observation, action and state of a row are of one step
    assert torch.allclose(
        batch.observation.proprio[:3, :, 0] * 10, (t - windows.start[t])[:3, None] + torch.arange(4.0)
    )


@pytest.mark.parametrize("head", ["gmm", "l1"])
def test_the_loss_of_a_window_is_the_mean_over_its_valid_steps(head, data):
    student = student_of(data, head=head)
    t = data.windows.end[data.windows.training[:1]] - 3
    batch = data.batch(t, generator())
    actions, mixture, _ = student(batch.observation)
    each = ((actions - batch.chunk).abs().sum(-1) if head == "l1" else -mixture.log_likelihood(batch.chunk))[
        0
    ]  # three valid steps
    loss = student.imitate(batch, guided=0, noise=0.0, generators=streams()).loss
    assert loss.item() == pytest.approx(each[:3].mean().item(), rel=1e-5)


def test_an_action_depends_on_earlier_observations_and_not_on_later_ones(data):
    student = student_of(data)
    seen = data.batch(data.windows.training[:8], generator()).observation
    vision = seen.vision.clone()
    vision[:, 2] += 1
    before, after = student.plan(seen), student.plan(replace(seen, vision=vision))
    changed = (before != after).any(-1).all(0)
    assert changed.tolist() == [False, False, True, True]


# --- memory ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("reset", [True, False])
def test_acting_through_a_demonstration_repeats_the_forward_pass_of_training(reset, data):
    """With reset, window by window; without, over the whole episode at once."""
    student = student_of(data, reset=reset).eval()
    begin, end = int(data.windows.start[0]), int(data.windows.end[0])
    goal = data.windows.episodes["goal"][:1]
    actions = acted(student, [window(data, begin, end - begin, goal)])[0]
    pieces = range(begin, end, 4) if reset else [begin]
    size = 4 if reset else end - begin
    expected = [student.plan(window(data, t, min(size, end - t), goal))[0] for t in pieces]
    assert np.allclose(actions, torch.cat(expected).numpy(), atol=1e-5)
    assert len(actions) == end - begin > 8


@pytest.mark.parametrize("reset", [True, False])
def test_memory_ends_after_sequence_steps(reset, data):
    student = student_of(data, reset=reset)
    seen = window(data, int(data.windows.start[0]), 10, data.windows.episodes["goal"][:1])
    vision = seen.vision.clone()
    vision[:, 1] += 3
    one, other = acted(student, [seen]), acted(student, [replace(seen, vision=vision)])
    changed = (one != other).any(-1)[0].tolist()
    assert changed == [False, True, True, True] + 6 * [not reset]


def test_rows_never_mix(data):
    student = student_of(data)
    goals = data.windows.episodes["goal"]
    first, last = (window(data, int(data.windows.start[t]), 10, goals[e][None]) for t, e in ((0, 0), (-1, -1)))
    both = acted(student, [first, last])
    assert not np.allclose(both[0], both[1])
    assert np.array_equal(both[0], acted(student, [first, first])[0])
    assert np.array_equal(both[1], acted(student, [last, last])[1])


def test_rows_at_different_steps_reset_on_their_own(data):
    """A row that starts while another is at its third step: each is reset after its own four steps."""
    student = student_of(data)
    policy = student.policy(ActingConfig())
    seen = window(data, int(data.windows.start[0]), 10, data.windows.episodes["goal"][:1])
    alone = acted(student, [seen, seen])[0]
    memory = policy.start(np.zeros(2, np.int64), seen.goal.numpy().repeat(2, 0), [0, 1])

    def act(memory, at: tuple[int, int]):
        rows = {"vision": seen.vision, "proprio": seen.proprio}
        return policy.act({name: value[0, list(at)].numpy() for name, value in rows.items()}, memory)

    for step in range(3):
        _, memory = act(memory, (step, step))
    fresh = policy.start(np.zeros(2, np.int64), seen.goal.numpy().repeat(2, 0), [0, 1])
    hidden = type(memory.hidden)(*(torch.stack([a[0], b[1]]) for a, b in zip(memory.hidden, fresh.hidden)))
    memory = memory._replace(hidden=hidden, steps=np.array([3, 0]))
    for step in range(5):
        actions, memory = act(memory, (3 + step, step))
        assert np.array_equal(actions[0], alone[3 + step]) and np.array_equal(actions[1], alone[step])


# --- gradients ------------------------------------------------------------------------------------------------


def reached(student: BCRNN, loss: Tensor) -> set[str]:
    """The parameters that a loss moves."""
    student.zero_grad(set_to_none=True)
    loss.backward()
    return {name for name, p in student.named_parameters() if p.grad is not None and p.grad.abs().max() > 0}


@pytest.mark.parametrize("head", ["gmm", "l1"])
def test_gradient_paths(head, data, tmp_path: Path):
    student = start(synthetic.student_request("bc_rnn", head=head), data, {"features": ()}, CPU)
    critics = [Critic.load(synthetic.critic(tmp_path / str(i), STATES[i], seed=i)) for i in range(2)]
    guidance = CriticGuidance(AggregateCritic(critics, 1.0), torch.ones(2), torch.ones(4))
    batch = data.batch(data.sample(16, generator()), generator())
    every = {name for name, _ in student.named_parameters()}

    imitation = student.imitate(batch, guided=16, noise=0.0, generators=streams())
    assert reached(student, imitation.loss.mean()) == every
    imitation = student.imitate(batch, guided=16, noise=0.0, generators=streams())
    spreads = {name for name in every if name.startswith("head.stds")}
    assert reached(student, guidance.loss(imitation.proposal, data.reference(batch)).mean()) == every - spreads
    assert torch.allclose(imitation.proposal, student.plan(batch.observation), atol=1e-6)


def test_a_likelihood_under_bfloat16_is_in_full_precision(data):
    student = student_of(data)
    batch = data.batch(data.sample(16, generator()), generator())
    with torch.autocast("cpu", torch.bfloat16):
        imitation = student.imitate(batch, guided=4, noise=0.0, generators=streams())
    assert imitation.loss.dtype == imitation.proposal.dtype == torch.float32
    assert torch.isfinite(imitation.loss).all()
