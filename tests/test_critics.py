"""Critics: fitted Q evaluation, its targets, the aggregate, and the measures of quality."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from pydantic import ValidationError

from acgd.critics import quality
from acgd.critics.aggregate import AggregateCritic
from acgd.critics.fit import fit
from acgd.critics.fitted_q import FittedQ, branch_targets
from acgd.critics.gather import branches, candidates, rollouts
from acgd.critics.perturbations import kinds, offsets
from acgd.critics.quality import measure
from acgd.critics.settings import (
    BranchConfig,
    CriticRequest,
    ExpertCriticSettings,
    FQESettings,
    PerturbationConfig,
    QualityConfig,
    QualityRequest,
    ZooCriticSettings,
)
from acgd.critics.spread import spread
from acgd.critics.targets import targets
from acgd.critics.transitions import ROLLOUT, Transitions, concatenate
from acgd.experts import zoo
from acgd.experts.policy import Expert
from acgd.experts.sac.settings import SACSettings
from acgd.experts.settings import ZooSettings
from acgd.nn.excitation import stretched_excitation, to_critic_input, to_loss_space
from acgd.nn.q_ensemble import Critic
from acgd.simulate.lockstep import Lockstep
from acgd.simulate.seeds import SEEDS
from acgd.store.metrics import Metrics, read
from acgd.store.progress import Progress
from acgd.store.stage import Context
from acgd.tasks.settings import TaskConfig

CPU = torch.device("cpu")
QUIET = Progress(open("/dev/null", "w"))
TASK = TaskConfig(name="myo/pen-twirl")
TINY = FQESettings(
    width=16, steps=60, updates=12, batch=16, branch_batch=2, target_every=5, checkpoint_every=4, horizon=8,
    branches=BranchConfig(states=3, actions=3, steps=3),
)  # fmt: skip
FEW = QualityConfig(states=4, candidates=5, tail=4)


def linear_problem(rows: int = 1500, terminal: bool = False) -> Transitions:
    """s' = 0.8 s + 0.2 a, r = s + 0.5 a, expert a = 0; each row is an episode, cut by a time limit or terminated."""
    rng = np.random.default_rng(0)
    state, action = (rng.uniform(-1, 1, (rows, 1)).astype(np.float32) for _ in range(2))
    return Transitions(
        state=state, action=action, reward=(state + 0.5 * action)[:, 0], next_state=0.8 * state + 0.2 * action,
        next_action=np.zeros((rows, 1), np.float32), terminated=np.full(rows, terminal), on_policy=np.zeros(rows, bool),
        branch=np.full(rows, ROLLOUT), ends=np.arange(1, rows + 1),
    )  # fmt: skip


def fitted(data: Transitions, config: FQESettings, gamma: float = 0.9) -> Critic:
    fit = FittedQ(data, config, gamma, CPU)
    while fit.step < config.updates:
        fit.update()
    return fit.critic.eval()


def a_critic(state_dim: int, seed: int, members: int = 2, dueling: bool = False) -> Critic:
    generator = torch.Generator().manual_seed(seed)
    critic = Critic(
        state_dim,
        3,
        members=members,
        width=16,
        depth=2,
        action_space="excitation",
        dueling=dueling,
        generator=generator,
    )
    if dueling:
        critic.advantage_unit.fill_(0.1 * (1 + seed))
    critic.state_mean.copy_(torch.randn(state_dim, generator=generator))
    critic.state_std.copy_(torch.rand(state_dim, generator=generator) + 0.5)
    critic.shift.fill_(-100.0 * seed)
    critic.scale.fill_(3.0 + seed)
    critic.spread.fill_(2.0 + seed)
    return critic.eval()


# -- targets and the fit ---------------------------------------------------------------------------


def test_targets_are_the_hand_computed_ones():
    # One episode: row 1 is perturbed, rows 2 and 3 follow the expert, the simulator terminates after row 3.
    # Another: both rows follow the expert, then the time limit.
    reward = np.array([1, 2, 4, 8, 1, 1], np.float32)
    terminated = np.array([0, 0, 0, 1, 0, 0], bool)
    on_policy = np.array([1, 0, 1, 1, 1, 1], bool)
    result = targets(reward, terminated, on_policy, np.array([4, 6]), gamma=0.5, horizon=10)
    next_value = torch.tensor([[10.0, 20.0, 30.0, 40.0, 50.0, 60.0]])
    expected = [
        1 + 0.5 * 10,  # the next action is perturbed: bootstrap at once
        2 + 0.5 * 4 + 0.25 * 8,  # its own noise does not matter, what follows is the expert; terminated, no bootstrap
        4 + 0.5 * 8,
        8,
        1 + 0.5 * 1 + 0.25 * 60,  # past the time limit
        1 + 0.5 * 60,
    ]
    assert result(next_value).tolist() == [expected]


def test_horizon_one_is_one_step_fitted_q_evaluation():
    reward, on_policy = np.array([1, 2, 3], np.float32), np.ones(3, bool)
    result = targets(reward, np.array([0, 0, 1], bool), on_policy, np.array([3]), gamma=0.5, horizon=1)
    assert result(torch.tensor([[10.0, 20.0, 30.0]])).tolist() == [[6.0, 12.0, 3.0]]


def test_fit_recovers_the_q_of_a_linear_problem():
    # V(s) = s / (1 - 0.8 * 0.5) = 5/3 s;  Q(s, a) = s + 0.5 a + 0.5 V(0.8 s + 0.2 a) = 5/3 s + 2/3 a
    critic = fitted(
        linear_problem(),
        FQESettings(action_space="raw", weight_decay=0.0, width=32, updates=500, batch=64, target_every=20, lr=5e-3),
        gamma=0.5,
    )
    state = torch.tensor([[0.5], [-0.5], [0.2], [0.0]])
    action = torch.tensor([[0.0], [0.5], [-0.8], [0.6]])
    expected = 5 / 3 * state[:, 0] + 2 / 3 * action[:, 0]
    assert torch.allclose(critic(state, action), expected.expand(2, -1), atol=0.1)


def test_terminated_transitions_are_worth_their_reward():
    critic = fitted(
        linear_problem(terminal=True),
        FQESettings(action_space="raw", weight_decay=0.0, width=32, updates=600, batch=128, lr=3e-3),
    )
    state, action = torch.tensor([[0.5], [-0.5]]), torch.tensor([[0.0], [0.5]])
    assert torch.allclose(critic(state, action), torch.tensor([0.5, -0.25]).expand(2, -1), atol=0.05)


def test_q_is_in_reward_units():
    # Rewards 1000 times as large: the same critic up to rounding, with 1000 times the values.
    data, config = linear_problem(200), FQESettings(action_space="raw", width=16, updates=40, batch=32)
    small, large = fitted(data, config), fitted(replace(data, reward=1000 * data.reward), config)
    state, action = torch.tensor([[0.5]]), torch.tensor([[0.3]])
    assert torch.allclose(1000 * small(state, action), large(state, action), rtol=1e-2)
    random = Expert.random(1, 1, seed=0)
    units = [spread(critic, random, data.state, np.random.default_rng(0)) for critic in (small, large)]
    assert units[1] / units[0] == pytest.approx(1000, rel=1e-2)


def test_a_dueling_critic_ranks_actions_where_the_value_of_states_drowns_them():
    rng = np.random.default_rng(0)
    state = np.repeat(rng.uniform(-1, 1, (200, 1)), 4, 0).astype(np.float32)
    action = rng.uniform(-1, 1, (800, 1)).astype(np.float32)
    data = replace(
        linear_problem(800), state=state, action=action, terminated=np.ones(800, bool),
        branch=np.repeat(np.arange(200), 4),
        reward=(30 * np.sin(3 * state) + 0.05 * action)[:, 0],
    )  # fmt: skip
    config = FQESettings(
        action_space="raw",
        weight_decay=0.0,
        width=16,
        updates=300,
        batch=64,
        lr=1e-2,
        branches=BranchConfig(states=200, actions=4),
    )
    tried = torch.linspace(-1, 1, 8)[:, None]
    ranked = {}
    for weight, dueling in ((1.0, True), (1.0, False), (0.0, True)):
        critic = fitted(data, config.model_copy(update={"within_state": weight, "dueling": dueling}))
        q = [critic(torch.full((8, 1), at), tried).mean(0).detach().numpy() for at in (-0.7, -0.2, 0.3, 0.8)]
        ranked[weight, dueling] = quality.rank_correlations(np.stack(q), np.repeat(tried.T.numpy(), 4, 0)).mean()
    assert ranked[1.0, True] > 0.9 and ranked[1.0, False] < 0.5 and ranked[0.0, True] < 0.5


def test_the_value_of_a_dueling_critic_knows_no_action():
    data = concatenate([linear_problem(60), replace(linear_problem(12), branch=np.repeat(np.arange(4), 3))])
    critic = fitted(data, TINY)
    with torch.no_grad():
        critic.advantage_unit.zero_()  # what is left is V
        state, action = torch.full((5, 1), 0.3), torch.linspace(-1, 1, 5)[:, None]
        assert (
            critic(state, action).std(1).max() < 1e-6 < critic(torch.linspace(-1, 1, 5)[:, None], action).std(1).min()
        )
    assert not critic.weights[0][: critic.members, 1:].any()


def test_resumed_fit_equals_an_uninterrupted_one(tmp_path: Path):
    data = concatenate([linear_problem(60), replace(linear_problem(12), branch=np.repeat(np.arange(4), 3))])
    whole = FittedQ(data, TINY, 0.9, CPU)
    for _ in range(11):
        whole.update()
    stopped = FittedQ(data, TINY, 0.9, CPU)
    for _ in range(7):  # between two refreshes of the targets
        stopped.update()
    stopped.save(tmp_path / "stopped")
    resumed = FittedQ(data, TINY, 0.9, CPU)
    resumed.resume(tmp_path / "nothing")
    assert resumed.step == 0
    resumed.resume(tmp_path / "stopped")
    assert resumed.step == 7
    for _ in range(4):
        resumed.update()
    whole.save(tmp_path / "whole")
    resumed.save(tmp_path / "resumed")
    files = [tmp_path / name / "checkpoint.safetensors" for name in ("whole", "resumed")]
    assert files[0].read_bytes() == files[1].read_bytes()


def test_branches_of_a_state_share_one_bootstrap():
    # Two states, two branches of one step each; the second state's second branch terminates.
    result = targets(
        np.array([1, 2, 3, 4], np.float32),
        np.array([0, 0, 0, 1], bool),
        np.zeros(4, bool),
        np.arange(1, 5),
        gamma=0.5,
        horizon=9,
    )
    value = torch.tensor([[10.0, 20.0, 30.0, 40.0]])
    z = branch_targets(result, value, torch.tensor([[0, 1], [2, 3]]))
    assert z.tolist() == [[1 + 0.5 * 15, 2 + 0.5 * 15], [3 + 0.5 * 30, 4]]


def test_differences_in_units_of_the_actions_distance():
    """Two states with actions at 0, 0.1 and 1. Returns climb by 2 per unit of action; by 4, but for the last action."""
    data = replace(
        linear_problem(6), action=np.array([[0], [0.1], [1], [0], [0.1], [1]], np.float32),
        reward=np.array([0, 0.2, 2, 0, 0.4, 0.4], np.float32),
        terminated=np.ones(6, bool), branch=np.array([0, 0, 0, 1, 1, 1]),
    )  # fmt: skip
    fit = FittedQ(data, TINY.model_copy(update={"action_space": "raw", "within_state_unit": "distance"}), 0.9, CPU)
    fit.refresh()
    scale, near = float(fit.critic.scale), 0.1 * 0.9  # the median of 0.1, 1, 0.9, twice
    assert (scale * fit.difference).tolist() == [
        pytest.approx([-0.2, -2, -1.8]),
        pytest.approx([-0.4, -0.4, 0], abs=1e-6),
    ]
    distance = np.array([0.1, 1, 0.9]) + near
    slopes = np.array(
        [np.sqrt(np.mean((rise / distance) ** 2)) for rise in (np.array([0.2, 2, 1.8]), np.array([0.4, 0.4, 0]))]
    )
    assert (scale * fit.unit).numpy() == pytest.approx(
        (slopes + slopes.min())[:, None] * distance, rel=1e-5
    )  # torch's median of two is the lower


def test_noise_on_states_is_one_draw_for_all_actions_of_a_branched_state():
    data = concatenate([linear_problem(60), replace(linear_problem(12), branch=np.repeat(np.arange(4), 3))])
    fit = FittedQ(data, TINY.model_copy(update={"state_noise": 0.5, "batch": 2000}), 0.9, CPU)
    moved = fit._with_state_noise(torch.ones(2000 + 2 * 3, 1)) - 1  # TINY has three actions a state
    assert float(moved[:2000].std()) == pytest.approx(0.5, rel=0.1)
    first, second = moved[2000:2003, 0].tolist(), moved[2003:, 0].tolist()
    assert len(set(first)) == len(set(second)) == 1 and first[0] != second[0]
    assert torch.equal(FittedQ(data, TINY, 0.9, CPU)._with_state_noise(torch.ones(6, 1)), torch.ones(6, 1))


def test_groups_of_unequal_size_are_refused():
    data = replace(linear_problem(5), branch=np.array([0, 0, 1, 1, 1]))
    with pytest.raises(ValueError, match="same number of actions"):
        FittedQ(data, TINY, 0.9, CPU)


# -- the ensemble and the aggregate ----------------------------------------------------------------


@pytest.mark.parametrize("dueling", [False, True])
def test_critic_comes_back_as_it_was_saved(tmp_path: Path, dueling: bool):
    critic = a_critic(5, 1, dueling=dueling)
    critic.meta = {"task": "myo/reach", "gamma": 0.97}
    critic.save(tmp_path)
    loaded = Critic.load(tmp_path)
    state, action = torch.randn(7, 5), torch.rand(7, 3)
    assert torch.equal(loaded(state, action), critic(state, action))
    assert loaded.meta == critic.meta and loaded(state, action).shape == (2, 7)
    assert float(loaded.spread) == 3.0


@pytest.mark.parametrize("dueling", [(False, False, False), (True, True, True), (True, False, True)])
def test_aggregate_is_the_critic_of_each_rows_task_in_its_units(dueling: tuple[bool, ...]):
    critics = [a_critic(size, seed, dueling=dueling[seed]) for seed, size in enumerate((5, 8, 6))]
    task = torch.tensor([2, 0, 2, 2, 0, 2])  # task 1 is absent, the others are unbalanced
    action, reference = (torch.rand(6, 3) * 2 - 1 for _ in range(2))
    state = torch.zeros(6, 8)
    for row, t in enumerate(task):
        state[row, : critics[t].shape["state_dim"]] = torch.randn(critics[t].shape["state_dim"])
    aggregate = AggregateCritic(critics, pessimism=0.5)
    gain = aggregate(state, action, reference, task)
    for row, t in enumerate(task):
        seen = state[row : row + 1, : critics[t].shape["state_dim"]]
        # `shift` cancels, and would only cost digits.
        by_member = (
            critics[t].scale
            * (critics[t].standard(seen, action[row : row + 1]) - critics[t].standard(seen, reference[row : row + 1]))[
                :, 0
            ]
        )
        expected = (by_member.mean() - 0.5 * by_member.std(correction=0)) / critics[t].spread
        assert float(gain[row].detach()) == pytest.approx(float(expected.detach()), rel=1e-4, abs=1e-5)
    assert aggregate(state, reference, reference, task).abs().max() < 1e-5


@pytest.mark.parametrize(
    ("members", "pessimism", "dueling"), [(1, 0.5, False), (2, 0.0, True), (2, 1.0, False), (2, 1.0, True)]
)
def test_gradient_reaches_the_action_and_nothing_else(members: int, pessimism: float, dueling: bool):
    critics = [a_critic(4, 0, members, dueling), a_critic(6, 1, members, dueling)]
    before = [value.clone() for critic in critics for value in critic.state_dict().values()]
    aggregate = AggregateCritic(critics, pessimism)
    aggregate.train()  # a student that calls .train() on all it holds changes nothing
    state, action, reference = (
        torch.randn(5, 6, requires_grad=True),
        torch.rand(5, 3, requires_grad=True),
        torch.rand(5, 3, requires_grad=True),
    )
    aggregate(state, action, reference, torch.tensor([0, 1, 1, 1, 0])).sum().backward()
    assert action.grad.isfinite().all() and (action.grad.abs().sum(1) > 0).all()
    assert state.grad is None and reference.grad is None and not list(aggregate.parameters())
    assert all(parameter.grad is None for critic in critics for parameter in critic.parameters())
    assert all(torch.equal(a, b) for a, b in zip(before, [v for c in critics for v in c.state_dict().values()]))


def test_aggregate_refuses_what_it_cannot_stack():
    with pytest.raises(ValueError, match="differ in members"):
        AggregateCritic([a_critic(4, 0, 1), a_critic(4, 1, 2)], 0.0)
    with pytest.raises(ValueError, match="task id 2 for 1 critics"):
        AggregateCritic([a_critic(4, 0)], 0.0)(
            torch.zeros(1, 4), torch.zeros(1, 3), torch.zeros(1, 3), torch.tensor([2])
        )


# -- perturbations and configuration ---------------------------------------------------------------


def test_kinds_keep_their_shares_and_noise_is_as_named():
    config = PerturbationConfig()
    given = [kind for kind, _ in zip(kinds(config), range(20))]
    assert [sum(name == kind for name, _ in given) for kind in ("clean", "gaussian", "bursts")] == [10, 6, 4]
    assert {scale for name, scale in given if name == "gaussian"} == {0.1, 0.2, 0.4}
    rng = np.random.default_rng(0)
    assert not offsets(("clean", 0.0), 50, 3, config, rng).any()
    assert offsets(("gaussian", 0.2), 4000, 3, config, rng).std() == pytest.approx(0.2, rel=0.05)
    burst = offsets(("bursts", 0.5), 400, 3, config, rng)
    followed = ~burst.any(1)
    assert 0.5 < followed.mean() < 0.95
    start = int(np.flatnonzero(~followed & np.roll(followed, 1))[1])
    assert (burst[start : start + config.burst_steps] == burst[start]).all()


def test_shares_that_do_not_sum_to_one_are_refused():
    with pytest.raises(ValidationError, match="make the three shares sum to 1"):
        PerturbationConfig(clean=0.9)
    with pytest.raises(ValidationError, match="wdth"):
        FQESettings(wdth=1)


# -- quality ---------------------------------------------------------------------------------------


def test_within_state_correlation_of_perfect_and_shuffled_values():
    rng = np.random.default_rng(0)
    returns = rng.standard_normal((200, 16)) - 1000 * rng.random((200, 1))
    perfect = quality.interval(quality.rank_correlations(3 * returns + 7, returns))
    assert perfect["mean"] == pytest.approx(1.0) and perfect["states"] == 200
    shuffled = quality.interval(quality.rank_correlations(rng.permuted(returns, axis=1), returns))
    assert shuffled["low"] < 0 < shuffled["high"] and abs(shuffled["mean"]) < 0.1
    # The value of the state alone, the same for all candidates, ranks nothing.
    assert np.isnan(quality.rank_correlations(np.repeat(returns[:, :1], 16, 1), returns)).all()


def test_the_interval_is_a_t_interval():
    result = quality.interval(np.array([0.0, 0.2, 0.4, np.nan]))
    assert result["mean"] == pytest.approx(0.2) and result["states"] == 3
    assert result["high"] - result["mean"] == pytest.approx(4.3027 * 0.2 / 3**0.5, rel=1e-4)


def test_discounted_returns():
    data = replace(linear_problem(4), reward=np.array([1, 2, 4, 8], np.float32), ends=np.array([3, 4]))
    assert quality.discounted(data, 0.5, steps=5).tolist() == [3.0, 4.0, 4.0, 8.0]
    assert quality.discounted(data, 0.5, steps=2).tolist() == [2.0, 4.0, 4.0, 8.0]


# -- with the simulator ----------------------------------------------------------------------------


@pytest.fixture(scope="module")
def lock() -> Lockstep:
    return Lockstep(TASK, 4, image_size=None)


@pytest.fixture(scope="module")
def expert(lock: Lockstep) -> Expert:
    space = lock.envs[0].observation_space["state"]
    return Expert.random(space.shape[0], 39, seed=0, meta={"gamma": 0.9, "task": TASK.name, "reward_weights": {}})


def test_a_branch_with_the_experts_action_repeats_the_rollout(lock: Lockstep, expert: Expert):
    with QUIET(1, "") as bar:
        data, visits, given = rollouts(
            lock,
            expert,
            PerturbationConfig(clean=1, gaussian=0, bursts=0),
            SEEDS.critic_quality,
            limit=6,
            extra_steps=60,
            episodes=2,
            visit_rate=1.0,
            bar=bar,
        )
        assert len(visits) <= 12 and len(given) == 2
        lengths = data.ends - data.starts
        assert (lengths <= 66).all() and (
            data.terminated[data.ends - 1] == (lengths < 66)
        ).all()  # past the task's 50 steps
        visit = next(v for v in visits if v.episode == 1)
        step = data.starts[1] + [v for v in visits if v.episode == 1].index(visit)
        actions, sources = candidates(expert, visit.state[None], 6, np.random.default_rng(0))
        tried = branches(lock, expert, [visit], actions, 5, bar)
    assert sources == ["mean", "sample", "gaussian 0.1", "gaussian 0.2", "gaussian 0.4", "uniform"]
    assert tried.branch[tried.starts].tolist() == [0] * 6 and (tried.branch == ROLLOUT).sum() == len(tried) - 6
    repeated = slice(0, tried.ends[0])
    # Up to rounding: the batch of the expert has two states there and four here.
    assert np.allclose(tried.reward[repeated], data.reward[step : step + tried.ends[0]], atol=1e-4)
    assert np.allclose(tried.next_state[repeated], data.next_state[step : step + tried.ends[0]], atol=1e-4)
    assert np.array_equal(tried.state[tried.starts], np.repeat(visit.state[None], 6, 0))
    assert np.array_equal(tried.action[tried.starts], actions[0]) and np.abs(tried.action).max() <= 1
    assert not np.array_equal(tried.next_state[tried.starts[1]], tried.next_state[0])


class Interrupting(Progress):
    """Stops the fit in the middle, as a kill would."""

    def __call__(self, total: int, what: str, done: int = 0):
        bar = super().__call__(total, what, done)
        if "fitted" in what:
            update, bar.calls = bar.update, 0

            def stop(n: int = 1, **shown: float) -> None:
                update(n, **shown)
                bar.calls += 1
                if bar.calls == 7:
                    raise KeyboardInterrupt

            bar.update = stop
        return bar


def context(folder: Path, name: str = "out", progress: Progress = QUIET) -> Context:
    out, state = folder / name, folder / f"{name}-state"
    out.mkdir(exist_ok=True)
    state.mkdir(exist_ok=True)
    return Context(out, state, Metrics(folder / f"{name}.jsonl"), progress, CPU)


def fit_and_measure(expert: Path, ctx: Context, critic, quality: QualityConfig, task: TaskConfig = TASK) -> dict:
    """Both stages into one folder; returns quality.json."""
    with ctx.metrics:
        fit(CriticRequest(task=task, critic=critic), {"expert": expert}, ctx)
        inputs = {"expert": expert, "critic": ctx.out}
        measure(QualityRequest(task=task, quality=quality), inputs, ctx)
    return json.loads((ctx.out / "quality.json").read_text())


def test_the_stage_resumes_to_the_same_bytes(tmp_path: Path, expert: Expert):
    expert.save(tmp_path)
    result = fit_and_measure(tmp_path, context(tmp_path, "whole"), TINY, FEW)
    with pytest.raises(KeyboardInterrupt):
        fit_and_measure(tmp_path, context(tmp_path, "killed", Interrupting(QUIET.stream)), TINY, FEW)
    fit_and_measure(tmp_path, context(tmp_path, "killed"), TINY, FEW)
    names = sorted(path.name for path in (tmp_path / "whole").iterdir())
    assert names == ["critic.json", "critic.safetensors", "quality.json", "within_state.csv"]
    for name in names:
        assert (tmp_path / "whole" / name).read_bytes() == (tmp_path / "killed" / name).read_bytes(), name
    curves = [read(tmp_path / f"{name}.jsonl") for name in ("whole", "killed")]
    assert curves[0] == curves[1] and [row["step"] for row in curves[0]] == [1, 6, 11]
    assert result["within_state"]["candidates"] == 5 and result["within_state"]["states"] <= 4
    assert result["within_state"]["low"] <= result["within_state"]["mean"] <= result["within_state"]["high"]
    assert result["spread"] > 0 and result["bellman_error"] > 0
    critic = Critic.load(tmp_path / "whole")
    assert critic.meta["task"] == TASK.name and critic.meta["simulator_steps"] >= 60


SMALLEST = dict(members=1, width=1, depth=1, steps=1, updates=1, batch=1, branch_batch=1, target_every=1, horizon=1)


@pytest.mark.parametrize(
    "settings",
    [
        dict(branches={"states": 0}, spread="near"),
        dict(branches={"states": 1, "actions": 2, "steps": 1}, within_state_unit="distance", state_noise=0.5),
        dict(branches={"states": 1, "actions": 9, "steps": 1}, dueling=False, checkpoint_every=1, within_state=0.0),
        dict(branches={"states": 0}, perturbation={"clean": 0, "gaussian": 0, "bursts": 1, "burst_every": 1}),
    ],
)
def test_the_smallest_settings_run(tmp_path: Path, expert: Expert, settings: dict):
    expert.save(tmp_path)
    quality = QualityConfig(states=2, candidates=4, tail=1)
    result = fit_and_measure(tmp_path, context(tmp_path), FQESettings(**SMALLEST, **settings), quality)
    assert all(np.isfinite(value) for value in result.values() if isinstance(value, float))
    assert all(value.isfinite().all() for value in Critic.load(tmp_path / "out").state_dict().values())


def test_too_few_states_with_a_ranking_give_no_interval():
    assert quality.interval(np.array([np.nan, 0.4])) == {"mean": 0.4, "low": -1.0, "high": 1.0, "states": 1}
    assert quality.interval(np.array([np.nan])) == {"mean": 0.0, "low": -1.0, "high": 1.0, "states": 0}


def test_settings_that_cannot_be_met_are_refused():
    with pytest.raises(ValidationError, match="Raise critic.steps, or lower critic.branches.states"):
        FQESettings(steps=10)
    with pytest.raises(ValidationError, match="Raise quality.perturbation.clean or quality.states"):
        QualityConfig(states=4, perturbation={"clean": 0.2, "gaussian": 0.5, "bursts": 0.3})
    few = PerturbationConfig(clean=0.2, gaussian=0.5, bursts=0.3)
    assert "clean" in [name for (name, _), _ in zip(kinds(few), range(5))]


@pytest.mark.parametrize(
    ("critic", "expert", "task", "fault"),
    [
        (FQESettings(), ZooSettings(), "myo/reach", None),
        (ZooCriticSettings(), ZooSettings(), "myo/reach", None),
        (ZooCriticSettings(), SACSettings(), "myo/reach", "myo/reach trains one. Set critic.kind: fqe"),
        (ExpertCriticSettings(), SACSettings(), "myo/reach", None),
        (ExpertCriticSettings(), ZooSettings(), "myo/pen-twirl", None),
        (ExpertCriticSettings(), ZooSettings(), "myo/reach", "the expert in zoo/ for myo/reach has no critics"),
    ],
)
def test_a_missing_critic_is_refused_with_the_mend(critic, expert, task: str, fault: str | None):
    faults = list(zoo.faults([(task, expert, critic)]))
    assert not faults if fault is None else len(faults) == 1 and fault in faults[0]


def test_the_unit_of_q_is_the_spread_over_actions_of_a_state_not_over_states(expert: Expert):
    class Known(torch.nn.Module):
        spread = torch.ones(())

        def forward(self, state: torch.Tensor, action: torch.Tensor) -> torch.Tensor:
            return (1e4 * state[:, 0] + 3.0 * action[:, 0])[None]

    states = np.random.default_rng(0).standard_normal((600, expert.hidden1.in_features)).astype(np.float32)
    actions, sources = candidates(expert, states, 16, np.random.default_rng(1))
    near = [source != "uniform" for source in sources]
    for over, counted in (("all", [True] * 16), ("near", near)):
        wanted = 3.0 * np.median(actions[:, counted, 0].std(1, ddof=1))
        assert spread(Known(), expert, states, np.random.default_rng(2), over) == pytest.approx(wanted, rel=0.1)


def test_a_ppo_expert_has_no_critics(tmp_path: Path, expert: Expert):
    expert.save(tmp_path)
    with pytest.raises(ValueError, match="critic.kind.*sac.*fqe"):
        fit(CriticRequest(task=TASK, critic=ExpertCriticSettings()), {"expert": tmp_path}, context(tmp_path))


def test_an_experts_critics_are_measured_like_fitted_ones(tmp_path: Path, expert: Expert):
    expert.save(tmp_path)
    Critic(expert.hidden1.in_features, 39, 2, 16, 2).save(tmp_path)
    ctx = context(tmp_path)
    result = fit_and_measure(tmp_path, ctx, ExpertCriticSettings(steps=60), FEW)
    meta = json.loads((ctx.out / "critic.json").read_text())
    assert meta["source"] == "expert" and meta["branched_states"] == 0
    assert {"rank_correlation_monte_carlo", "within_state", "bellman_error"} <= result.keys()
    assert Critic.load(ctx.out).spread > 0


def test_the_zoos_critic_is_that_of_the_zoos_expert_alone(tmp_path: Path):
    name = "opdex/spray-1"
    request = CriticRequest(task=TaskConfig(name=name), critic=ZooCriticSettings())
    assert request.files() == zoo.fitted_critic(name) and CriticRequest(task=TASK).files() == ()
    ctx = context(tmp_path)
    fit(request, {"expert": zoo.folder(name)}, ctx)
    assert sorted(path.name for path in ctx.out.iterdir()) == sorted(zoo.CRITIC)
    critic, expert = Critic.load(ctx.out), Expert.load(zoo.folder(name))
    assert critic.meta["task"] == name and critic.shape["state_dim"] == expert.hidden1.in_features
    with pytest.raises(ValueError, match="critic.kind.*fqe"):
        fit(request, {"expert": zoo.folder("opdex/spray-2")}, ctx)


def test_the_two_excitations_differ_and_agree_on_raw_actions():
    """Students compare actions in units of the box; the published critics read 2 u - 1."""
    ends, some = torch.tensor([-1.0, 1.0]), torch.linspace(-1, 1, 9)
    assert stretched_excitation(ends).tolist() == pytest.approx([-1, 1], abs=1e-6)
    assert to_critic_input(ends, "excitation").tolist() == pytest.approx([-0.99889, 0.84828], abs=1e-5)
    assert torch.equal(to_loss_space(some, "excitation"), stretched_excitation(some))
    assert to_loss_space(some, "raw") is some and to_critic_input(some, "raw") is some
