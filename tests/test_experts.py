"""Experts: PPO that resumes, policies that are plain torch, cards that belong to their weights."""

import json
import re
import shutil

import numpy as np
import pytest
import torch
from pydantic import ValidationError
from safetensors.torch import load_file

from acgd.critics.settings import FQESettings
from acgd.experts import card, zoo
from acgd.experts.card import measure
from acgd.experts.kinds import LEARNERS
from acgd.experts.muscle import learn as muscle
from acgd.experts.muscle.control import _ERRORS, MuscleControl
from acgd.experts.muscle.settings import CONTROLLED_KINDS, ControllerSettings
from acgd.experts.policy import LOG_STD, Expert
from acgd.experts.ppo import learn as ppo
from acgd.experts.sac import learn as sac
from acgd.experts.sac.replay import Replay
from acgd.experts.sac.settings import SACSettings
from acgd.experts.sac.update import SACUpdate
from acgd.experts.settings import CardRequest, ExpertRequest
from acgd.experts.train import train
from acgd.experts.training_env import StateOnly
from acgd.nn.excitation import stretched_excitation
from acgd.nn.q_ensemble import Critic
from acgd.simulate.proportion import wilson
from acgd.store.key import file_digest, in_key
from acgd.store.metrics import Metrics, read
from acgd.store.progress import Progress
from acgd.store.stage import Context
from acgd.tasks.settings import TaskConfig

SHARED = dict(steps=96, envs=2, width=8, evaluate_every=32, evaluation_episodes=2, checkpoint_every=32)
SMALL = {
    "ppo": SHARED | dict(rollout_steps=16, batch=16, epochs=2, learning_rate=1e-3, learning_rate_end=1e-4),
    "sac": SHARED | dict(random_steps=16, updates_per_step=0.5, batch=8),
    "muscle": SHARED | dict(rounds=3, epochs=2, batch=16),
}
IMITATION = dict(steps=32, rounds=2, epochs=2, batch=16)


def small(kind="ppo", task="myo/pen-twirl", **settings):
    return ExpertRequest(task=TaskConfig(name=task), expert={"kind": kind, **SMALL[kind], **settings})


REQUEST = small()
REQUESTS = {"ppo": REQUEST, "sac": small("sac"), "muscle": small("muscle", "myo/reach")}
MODULES = {"ppo": (ppo, ppo.train_ppo), "sac": (sac, sac.train_sac), "muscle": (muscle, muscle.train_muscle)}


def learned(learn, request, folder):
    """The best expert and the learning curve, trained in `folder`."""
    with open(folder / "log", "w") as stream:
        best, points = learn(request, folder, Metrics(folder / "metrics.jsonl"), Progress(stream))
    return Expert.load(best), points


class Killed(Exception):
    """Stands for a kill."""


def run(algorithm, folder, stop_after=None, monkeypatch=None):
    """Train in `folder`; with `stop_after`, die after so many checkpoints."""
    module, learn = MODULES[algorithm]
    if stop_after is not None:
        left, save = [stop_after], module._save

        def saving(*arguments):
            save(*arguments)
            left[0] -= 1
            if left[0] == 0:
                raise Killed

        monkeypatch.setattr(module, "_save", saving)
    with open(folder / "progress.log", "w") as stream:
        return learn(REQUESTS[algorithm], folder / "state", Metrics(folder / "metrics.jsonl"), Progress(stream))


@pytest.mark.parametrize("algorithm", MODULES)
def test_resumed_run_equals_an_uninterrupted_one(tmp_path, monkeypatch, algorithm):
    monkeypatch.setattr(sac, "SEGMENT", 32)
    whole, cut = tmp_path / "whole", tmp_path / "cut"
    whole.mkdir(), cut.mkdir()
    run(algorithm, whole)
    with monkeypatch.context() as patch, pytest.raises(Killed):
        run(algorithm, cut, 1, patch)
    assert (cut / "state/checkpoint.safetensors").is_file()
    run(algorithm, cut)
    a, b = (load_file(folder / "state/checkpoint.safetensors") for folder in (whole, cut))
    assert a.keys() == b.keys() and all(torch.equal(a[name], b[name]) for name in a)
    for name in ("policy.safetensors", *(("critic.safetensors",) if algorithm == "sac" else ())):
        best = [(folder / "state/best" / name).read_bytes() for folder in (whole, cut)]
        assert best[0] == best[1]


def test_replay_sums_n_rewards_bootstraps_past_time_limits_and_stops_at_terminations(tmp_path):
    """Two episodes of rewards 1, 2, 3 with n = 2 and gamma = 0.5: one ends at a time limit, the other terminates."""
    replay = Replay(tmp_path, 6, 1, 1, n_step=2, gamma=0.5, envs=1)
    state = np.zeros(1)  # one array for all steps, as environments in lockstep have
    for terminated in (False, True):
        for t in range(3):
            state[:] = t
            replay.add(0, state, np.zeros(1), t + 1, np.array([t + 1]), terminated and t == 2, t == 2)
    rows = {name: array[: replay.count].ravel().tolist() for name, array in replay._arrays.items()}
    assert rows["state"] == [0, 1, 2] * 2 and rows["next_state"] == [2, 3, 3] * 2
    assert rows["reward"] == [1 + 0.5 * 2, 2 + 0.5 * 3, 3] * 2
    assert rows["discount"] == [0.25, 0.25, 0.5, 0.25, 0, 0]
    replay.add(0, np.array([9]), np.zeros(1), 1, np.array([9]), False, False)
    replay.abandon()
    assert replay.count == 6
    again = Replay(tmp_path, 6, 1, 1, n_step=2, gamma=0.5, envs=1)
    assert again._arrays["reward"].tolist() == rows["reward"]


def learner(**settings) -> SACUpdate:
    return SACUpdate(
        3, 2, SACSettings(width=16, batch=32, precision="float32", **settings), torch.Generator().manual_seed(0)
    )


def batch_of(reward: float, discount: float) -> tuple:
    g = torch.Generator().manual_seed(1)
    state, action = torch.randn(32, 3, generator=g), torch.rand(32, 2, generator=g) * 2 - 1
    return state, action, torch.full((32,), reward), torch.randn(32, 3, generator=g), torch.full((32,), discount)


def test_sac_density_is_that_of_its_actions():
    """Integrated over the box by a histogram of samples in one state and one dimension."""
    update = learner()
    actions, log_prob = update.sample(torch.zeros(200_000, 3))
    one = actions[:, 0].detach().numpy()
    mean, log_std = (value[0, 0].detach().double() for value in update.actor.gaussian(torch.zeros(1, 3)))
    density, edges = np.histogram(one, bins=40, range=(-0.8, 0.8))
    centre = torch.from_numpy((edges[1:] + edges[:-1]) / 2)
    wanted = torch.distributions.Normal(mean, log_std.exp()).log_prob(centre.atanh()).exp() / (1 - centre**2)
    assert density / len(one) / (edges[1] - edges[0]) == pytest.approx(wanted.numpy(), abs=0.06)
    normals = torch.distributions.Normal(
        *(
            v[0].detach() if i == 0 else v[0].detach().exp()
            for i, v in enumerate(update.actor.gaussian(torch.zeros(1, 3)))
        )
    )
    wanted = (normals.log_prob(actions.detach().atanh()) - torch.log(1 - actions.detach() ** 2)).sum(-1)
    assert log_prob.detach()[:100].numpy() == pytest.approx(wanted[:100].numpy(), abs=1e-3)


def test_sac_critics_learn_the_reward_where_nothing_follows_and_the_policy_climbs_them():
    update = learner(learning_rate=1e-2, temperature=1e-3)
    state, action, _, after, _ = batch_of(0, 0)
    update.normalise(torch.zeros(3), torch.ones(3), 2.0)
    for _ in range(300):
        update.update((state, action, 4 * action[:, 0], after, torch.zeros(32)))
    assert update.critic(state, action).mean(0).detach().numpy() == pytest.approx(4 * action[:, 0].numpy(), abs=0.6)
    assert update.actor.mean_tensor(state)[:, 0].min() > 0.5


def test_sac_target_moves_by_tau_and_only_the_critics_step_between_policy_updates():
    update = learner(actor_every=2, tau=0.25)
    update.update(batch_of(1.0, 0.9))
    policy, old = (
        [p.detach().clone() for p in update.actor.parameters()],
        [p.clone() for p in update.target.parameters()],
    )
    update.update(batch_of(1.0, 0.9))
    assert all(torch.equal(a, b) for a, b in zip(policy, update.actor.parameters()))
    for before, after, critic in zip(old, update.target.parameters(), update.critic.parameters()):
        assert torch.allclose(after, before + 0.25 * (critic.detach() - before), atol=1e-6)


@pytest.mark.parametrize(
    ("instructions", "arithmetic"),
    [({"avx2": True}, torch.float32), ({"avx2": True, "avx512_bf16": True}, torch.bfloat16)],
)
def test_bfloat16_is_asked_of_a_processor_only_where_it_has_it(instructions, arithmetic, monkeypatch):
    """Elsewhere the same settings give what float32 gives, bit for bit."""
    monkeypatch.setattr(torch.cpu, "get_capabilities", lambda: instructions)
    weights = {}
    for precision in ("float32", "bfloat16"):
        update = SACUpdate(3, 2, SACSettings(width=16, batch=32, precision=precision), torch.Generator().manual_seed(0))
        update.update(batch_of(1.0, 0.9))
        weights[precision] = update.critic.weights[0].detach()
    assert update._networks["critic"].weights[0].dtype == arithmetic and weights["bfloat16"].dtype == torch.float32
    assert torch.equal(weights["float32"], weights["bfloat16"]) == (arithmetic == torch.float32)


@pytest.mark.parametrize("precision", ["float32", "bfloat16"])
def test_sac_s_networks_batches_and_noise_meet_on_its_device(precision, monkeypatch):
    """On a device without numbers, which refuses to mix with the processor just as a GPU does."""
    monkeypatch.setattr(torch.optim, "Adam", lambda weights, rate, fused, Adam=torch.optim.Adam: Adam(weights, rate))
    update = SACUpdate(
        3,
        2,
        SACSettings(width=16, batch=32, precision=precision),
        torch.Generator().manual_seed(0),
        torch.device("meta"),
    )
    update.normalise(torch.zeros(3), torch.ones(3), 1.0)
    for _ in range(2):
        update.update(batch_of(1.0, 0.9))
    assert update.step == 2 and {value.device.type for value in update.tensors().values() if value.ndim} == {"meta"}


def test_squashed_expert_survives_the_disk_and_its_spread_depends_on_the_state(tmp_path):
    expert = Expert(4, 2, 8, {"gamma": 0.9}, squashed=True)
    expert.spread.weight.normal_(generator=torch.Generator().manual_seed(0))
    expert.save(tmp_path)
    again = Expert.load(tmp_path)
    states = np.random.default_rng(0).normal(size=(6, 4)).astype(np.float32)
    assert again.squashed and np.array_equal(again.mean(states), expert.mean(states))
    log_std = again.gaussian(torch.from_numpy(states))[1]
    assert log_std.std(0).min() > 0 and LOG_STD[0] < log_std.min() and log_std.max() < LOG_STD[1]
    assert np.abs(again.sample(100 * states, np.random.default_rng(0))).max() <= 1


def test_every_learner_is_in_the_registry_and_in_these_tests():
    assert set(LEARNERS) == {"zoo", *MODULES}


def test_a_learner_has_no_settings_of_another_and_a_warm_start_brings_its_own():
    with pytest.raises(ValidationError, match="rollout_steps"):
        small("sac", rollout_steps=16)
    with pytest.raises(ValidationError, match="muscle is read with warm_start: muscle only.*muscle to null"):
        small("ppo", muscle={"rate": 2.0})
    assert small("sac").expert.muscle is None
    given, default = small("sac", warm_start="muscle", muscle={}), small("sac", warm_start="muscle")
    assert in_key(given) == in_key(default) and in_key(default)["expert"]["muscle"]["rate"] == 8.0
    assert "muscle" not in default.expert.model_fields_set  # a variant may leave the warm start out again
    assert small("ppo", warm_start="muscle").expert.imitation().width == 8
    assert in_key(small(checkpoint_every=1)) == in_key(small(checkpoint_every=2))


def test_files_outside_the_store_are_those_that_are_read():
    assert ExpertRequest(task=TaskConfig(name="myo/reach")).files() == zoo.policy_files("myo/reach")
    assert {path.name for path in zoo.policy_files("myo/pen-twirl")} == {*zoo.POLICY, *zoo.CRITIC}
    assert small("sac", warm_start="myo/pen-twirl").files() == zoo.policy_files("myo/pen-twirl")
    assert small("ppo", "myo/reach", warm_start="muscle").files() == small().files() == ()
    task = TaskConfig(name="myo/reach")
    assert {path.name for path in CardRequest(task=task).files()} == set(zoo.CARD)
    assert CardRequest(task=task, expert=small().expert).files() == ()


@pytest.mark.parametrize(
    ("settings", "task", "fault"),
    [
        ({"kind": "ppo", "warm_start": "myo/reech"}, "myo/reach-hard", "warm_start: zoo/ has no expert for myo/reech"),
        ({"kind": "sac", "warm_start": "myo/reach"}, "myo/reach-hard", "no critics for SAC to go on with"),
        ({"kind": "ppo", "warm_start": "muscle"}, "myo/obj-hold", "warm_start: myo/obj-hold has no muscle controller"),
        ({"kind": "muscle"}, "opdex/spray-1", "expert.kind: opdex/spray-1 has no muscle controller"),
        ({"kind": "ppo", "advanced_starts": 0.5}, "myo/reach", "advanced_starts: myo/reach has no start"),
        ({"kind": "sac", "advanced_starts": 0.5}, "myo/pose", None),
        ({"kind": "ppo", "warm_start": "muscle"}, "myo/reach", None),
        ({}, "myo/reach", None),
    ],
)
def test_what_a_task_or_the_zoo_lacks_is_a_fault_with_its_mend(settings, task, fault):
    expert = ExpertRequest(task=TaskConfig(name=task), expert=settings).expert
    faults = list(zoo.faults([(task, expert, FQESettings())]))
    assert not faults if fault is None else len(faults) == 1 and fault in faults[0]


def test_kinds_of_tasks_that_settings_name_are_those_of_the_code():
    assert set(CONTROLLED_KINDS) == set(_ERRORS)


def test_settings_that_no_training_can_use_are_refused():
    with pytest.raises(ValidationError, match="Raise steps, or lower rounds or envs"):
        small("muscle", steps=5, rounds=3)
    with pytest.raises(ValidationError, match="raise envs or rollout_steps"):
        small(envs=1, rollout_steps=1)


@pytest.mark.parametrize(
    ("kind", "task", "settings"),
    [
        ("ppo", "myo/reach", dict(steps=1, envs=1, rollout_steps=2, batch=2, epochs=1)),
        ("sac", "myo/reach", dict(steps=24, envs=8, random_steps=1, batch=2, replay=1, updates_per_step=1.0)),
        ("sac", "myo/reach", dict(steps=1, envs=8, n_step=40)),
        ("muscle", "myo/reach", dict(steps=2, rounds=1, envs=1, epochs=1, batch=2)),
    ],
)
def test_the_smallest_settings_train(kind, task, settings, tmp_path):
    request = small(kind, task, evaluation_episodes=1, **settings)
    expert, points = learned(MODULES[kind][1], request, tmp_path)
    assert all(value.isfinite().all() for value in expert.state_dict().values()) and points


def test_learning_rate_falls_over_the_whole_run():
    rate = ppo._LearningRate(REQUEST.expert)
    seen = []
    for rate.step in (0, 48, 96):
        seen.append(rate(0.0))
    assert seen == pytest.approx([1e-3, 5.5e-4, 1e-4])


def test_exported_expert_acts_like_the_trained_policy(tmp_path):
    from stable_baselines3 import PPO
    from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize

    env = StateOnly(REQUEST, 0)
    venv = VecNormalize(DummyVecEnv([lambda: env]))
    venv.reset()
    for _ in range(20):
        venv.step(np.zeros((1, 39), np.float32))
    model = PPO("MlpPolicy", venv, n_steps=16, batch_size=16, policy_kwargs={"net_arch": [8, 8]}, device="cpu")
    raw = venv.get_original_obs()
    wanted = np.clip(model.predict(venv.normalize_obs(raw), deterministic=True)[0], -1, 1)
    expert = ppo.export(model, venv, {"gamma": 0.97})
    assert expert.mean(raw) == pytest.approx(wanted, abs=1e-5)
    expert.save(tmp_path)
    again = Expert.load(tmp_path)
    assert np.array_equal(again.mean(raw), expert.mean(raw)) and again.meta == expert.meta


def test_training_goes_on_from_another_task_s_expert_and_refuses_one_that_does_not_fit(tmp_path):
    """Before its first update, the policy is the expert of the other task."""
    request = small("ppo", "myo/reach-hard", width=256, warm_start="myo/reach")
    first = Expert.load(zoo.folder("myo/reach"))
    states = np.random.default_rng(0).normal(size=(4, first.hidden1.in_features)).astype(np.float32)
    result = []
    with pytest.MonkeyPatch.context() as patch, open(tmp_path / "log", "w") as log:
        start = ppo._start_from

        def starting(expert, name, model, venv):
            start(expert, name, model, venv)
            result.append(ppo.export(model, venv, {}).mean(states))
            raise Killed

        patch.setattr(ppo, "_start_from", starting)
        with pytest.raises(Killed):
            ppo.train_ppo(request, tmp_path, Metrics(tmp_path / "metrics.jsonl"), Progress(log))
        assert result[0] == pytest.approx(first.mean(states), abs=1e-4)
        narrow = small("ppo", "myo/reach-hard", warm_start="myo/reach")
        with pytest.raises(ValueError, match="warm_start.*myo/reach.*width"):
            ppo.train_ppo(narrow, tmp_path, Metrics(tmp_path / "metrics.jsonl"), Progress(log))
    with pytest.raises(ValidationError, match="warm_start"):
        small("muscle", "myo/reach", warm_start="myo/reach")


def test_sac_goes_on_from_another_task_s_expert_and_its_critics(tmp_path):
    """Its first steps are that expert's, with noise; policy and critics are those of the zoo until the first update."""
    settings = dict(steps=16, random_steps=16, width=256, action_space="excitation", warm_start="myo/obj-hold-hard")
    request = small("sac", "myo/obj-hold", **settings)
    first = zoo.folder("myo/obj-hold-hard")
    with open(tmp_path / "log", "w") as log:
        best, _ = sac.train_sac(request, tmp_path, Metrics(tmp_path / "metrics.jsonl"), Progress(log))
        expert = Expert.load(best)
        known, critics, trained = Expert.load(first), Critic.load(first), Critic.load(tmp_path / "best")
        assert torch.equal(expert.action.weight, known.action.weight) and torch.equal(
            trained.weights[0], critics.weights[0]
        )
        assert trained.scale == pytest.approx(float(critics.scale), rel=0.01) and expert.state_std == pytest.approx(
            known.state_std, rel=0.01
        )
        states = np.fromfile(tmp_path / "replay" / "state.f32", np.float32).reshape(-1, len(known.state_mean))[:8]
        tried = np.fromfile(tmp_path / "replay" / "action.f32", np.float32).reshape(-1, 39)[:8]
        assert (
            np.abs(tried - known.mean(states)).mean() < 0.3 < np.abs(tried - known.mean(np.roll(states, 1, 1))).mean()
        )
        narrow = small("sac", "myo/obj-hold", warm_start="myo/obj-hold-hard")
        with pytest.raises(ValueError, match="warm_start have other sizes"):
            sac.train_sac(narrow, tmp_path / "small", Metrics(tmp_path / "metrics.jsonl"), Progress(log))


def test_ppo_goes_on_from_an_imitation_of_the_muscle_controller(tmp_path):
    """The imitation is trained once; then PPO trains the policy on, and a resumed run needs no imitation any more."""
    request = small("ppo", "myo/reach", warm_start="muscle", muscle=IMITATION)
    expert, points = learned(ppo.train_ppo, request, tmp_path)
    imitation = Expert.load(tmp_path / "muscle" / "best")
    assert [point["step"] for point in points] == [32, 64, 96]
    assert expert.state_mean == pytest.approx(imitation.state_mean, abs=0.05)
    shutil.rmtree(tmp_path / "muscle")
    again, _ = learned(ppo.train_ppo, request, tmp_path)
    assert torch.equal(again.action.weight, expert.action.weight)


def test_the_value_function_learns_before_a_policy_with_a_warm_start_moves(tmp_path, monkeypatch):
    """For VALUE_ONLY_STEPS steps; a run from nothing moves at once."""
    moved = {}
    for first, still in (("muscle", 96), ("muscle", 64), ("", 96)):
        folder = tmp_path / f"{first}{still}"
        folder.mkdir()
        monkeypatch.setattr(ppo, "VALUE_ONLY_STEPS", still)
        saved = []
        monkeypatch.setattr(
            ppo,
            "_save",
            lambda state, model, *_, saved=saved: saved.append(
                {name: value.clone() for name, value in model.policy.state_dict().items()}
            ),
        )
        request = small("ppo", "myo/reach", warm_start=first, muscle=IMITATION if first else None)
        learned(ppo.train_ppo, request, folder)
        assert len(saved) == 3
        moved[first, still] = [
            tuple(
                not torch.equal(before[name], after[name])
                for name in ("action_net.weight", "log_std", "value_net.weight")
            )
            for before, after in zip(saved, saved[1:])
        ]
    assert moved == {
        ("muscle", 96): [(False, False, True), (False, False, True)],
        ("muscle", 64): [(False, False, True), (True, True, True)],
        ("", 96): [(True, True, True), (True, True, True)],
    }


def test_sac_s_first_steps_are_its_teacher_s(tmp_path):
    """Near them: noise is added. Without a teacher they are random."""
    near = {}
    for first in ("muscle", ""):
        folder = tmp_path / (first or "random")
        folder.mkdir()
        request = small("sac", "myo/reach", steps=16, warm_start=first)
        learned(sac.train_sac, request, folder)
        env = StateOnly(request, 0)
        env.reseed([0, 0, 0])
        env.reset()
        tried = np.fromfile(folder / "replay" / "action.f32", np.float32, 39)
        near[first] = np.square(tried - MuscleControl(env.unwrapped, ControllerSettings()).action()).mean()
    assert near["muscle"] < 0.15 < 0.5 < near[""]


@pytest.mark.parametrize(
    ("task", "entry", "settings", "most"),
    [
        ("myo/reach", "reach_err", ControllerSettings(), 0.03),
        ("myo/reach-hard", "reach_err", ControllerSettings(), 0.045),
        ("myo/pose", "pose_err", ControllerSettings(rate=2.5, damping=0.3), 0.55),
    ],
)
def test_the_muscle_controller_gets_there_and_holds(task, entry, settings, most):
    """From nearly all starts; fingertips end well inside the 62.5 mm that count, joints inside the 0.7 rad."""
    env = StateOnly(small("ppo", task), 0).unwrapped
    teacher, left, held = MuscleControl(env, settings), [], 0
    for seed in range(5):
        env.reset(seed=seed)
        ended = False
        while not ended:
            observation, _, terminated, truncated, info = env.step(teacher.action())
            ended = terminated or truncated
        left.append(np.linalg.norm(observation["state"][env.state_layout[entry]]))
        held += info["success"]["final"] and info["success"]["held"]
    assert held >= 4 and np.median(left) < most


def test_the_muscle_controller_leaves_the_simulation_as_it_was():
    one, other = (StateOnly(small("ppo", "myo/pose-hard"), 0).unwrapped for _ in range(2))
    teacher = MuscleControl(one, ControllerSettings())
    one.reset(seed=1), other.reset(seed=1)
    for _ in range(20):
        action = teacher.action()
        assert action.shape == (39,) and np.abs(action).max() <= 1
        assert np.array_equal(one.step(action)[0]["state"], other.step(action)[0]["state"])


@pytest.mark.parametrize("task", ["myo/obj-hold", "opdex/spray-1"])
def test_other_tasks_have_no_muscle_controller(task):
    with pytest.raises(ValueError, match=f"{task}.*pose, reach.*ppo or sac"):
        MuscleControl(StateOnly(small("ppo", task), 0).unwrapped, ControllerSettings())


def test_the_imitation_learns_what_the_controller_does(tmp_path):
    """In muscle excitations, on states that it visited itself."""
    settings = dict(steps=4800, rounds=3, width=64, envs=8, epochs=6, batch=256, evaluation_episodes=20)
    expert, points = learned(muscle.train_muscle, small("muscle", "myo/reach", **settings), tmp_path)
    last = load_file(tmp_path / "round-002.safetensors")
    wanted, given = stretched_excitation(last["actions"]), stretched_excitation(expert.mean_tensor(last["states"]))
    missed = (given - wanted).square().mean() / wanted.var(0).mean()
    assert missed < 0.5 and points[-1]["loss"] < 0.05


def test_only_some_tasks_train_from_starts_on_the_way():
    with pytest.raises(ValueError, match="myo/pen-twirl.*advanced_starts"):
        StateOnly(small(advanced_starts=1.0), 0)
    error = {}
    for share in (1.0, 0.0):
        env = StateOnly(small("ppo", "myo/pose", advanced_starts=share), 0)
        error[share] = np.mean(
            [np.abs(env.reset()[0][env.unwrapped.state_layout["pose_err"]]).sum() for _ in range(10)]
        )
    assert error[1.0] < 0.75 * error[0.0]


def test_sampled_actions_stay_in_the_box_and_spread_around_the_mean():
    expert = Expert.random(5, 3, seed=1)
    state = np.zeros((4000, 5), np.float32)
    actions = expert.sample(state, np.random.default_rng(0))
    assert np.abs(actions).max() <= 1
    assert actions.std(0) == pytest.approx(np.exp(-1), abs=0.05)


@pytest.fixture
def entry(tmp_path, monkeypatch):
    """A copy of one zoo entry, in an otherwise empty zoo."""
    source = zoo.folder("myo/reach")
    monkeypatch.setattr(zoo, "ROOT", tmp_path)
    return shutil.copytree(source, tmp_path / "myo-reach")


def test_sound_card_passes(entry):
    assert card.check(entry)["task"] == "myo/reach"


def test_card_of_other_weights_is_refused_with_the_mend(entry):
    weights = entry / "policy.safetensors"
    content = bytearray(weights.read_bytes())
    content[-1] ^= 1
    weights.write_bytes(content)
    with pytest.raises(ValueError, match="not the card.*zoo card myo-reach"):
        card.check(entry)


def test_critics_of_other_weights_are_refused(entry):
    content = json.loads((entry / "card.json").read_text())
    Critic(3, 2).save(entry)
    with pytest.raises(ValueError, match="not the card of the critic.safetensors"):
        card.check(entry)
    card.write(content | {"critic_sha256": file_digest(entry / "critic.safetensors")}, entry)
    card.check(entry)
    (entry / "critic.safetensors").unlink()
    with pytest.raises(ValueError, match="not the card of the critic.safetensors"):
        card.check(entry)


def test_the_fitted_critic_of_another_policy_is_refused(entry):
    content = json.loads((entry / "card.json").read_text())
    expert = Expert.load(entry)
    expert.action.bias.add_(1e-3)
    expert.save(entry)
    card.write(content | {"sha256": file_digest(entry / "policy.safetensors")}, entry)
    with pytest.raises(ValueError, match="critic holds the critic of another policy.*critic.kind: fqe"):
        card.check(entry)


def test_other_versions_than_those_of_the_training_are_a_warning(entry, capsys):
    from acgd.__main__ import main

    content = json.loads((entry / "card.json").read_text())
    card.write(content | {"versions": content["versions"] | {"mujoco": "0.1"}}, entry)
    assert main(["zoo", "manifest"]) == main(["zoo", "verify"]) == 0
    printed = capsys.readouterr().out
    assert "mujoco" in printed and "0.1 when it was measured" in printed and "re-evaluate" in printed
    with pytest.raises(SystemExit, match="nearest is myo-reach"):
        main(["zoo", "evaluate", "myo/reech"])


def test_the_manifest_of_the_zoo_names_every_file_and_what_defines_the_task(entry, capsys):
    from acgd.__main__ import main

    assert main(["zoo", "verify"]) == 1 and "manifest.json is missing" in capsys.readouterr().out
    assert main(["zoo", "manifest"]) == main(["zoo", "verify"]) == 0
    assert "# Expert of myo/reach" in (entry / "README.md").read_text()
    curve = (entry / "curve.csv").read_text()
    (entry / "curve.csv").write_text(curve + "\n")
    assert main(["zoo", "verify"]) == 1 and "curve.csv is not the file of the release" in capsys.readouterr().out
    (entry / "curve.csv").write_text(curve)
    manifest = zoo.ROOT / "manifest.json"
    manifest.write_text(re.sub('"episode": "[^"]*"', '"episode": "other"', manifest.read_text()))
    assert main(["zoo", "verify"]) == 1 and "has changed since its expert was measured" in capsys.readouterr().out


def test_the_zoo_is_what_its_manifest_says(capsys):
    from acgd.__main__ import main

    assert main(["zoo", "verify"]) == 0, capsys.readouterr().out


def test_missing_entry_names_what_the_zoo_has(entry, tmp_path):
    with pytest.raises(FileNotFoundError, match="myo-pose lacks.*myo/reach"):
        card.check(entry.parent / "myo-pose")
    with pytest.raises(FileNotFoundError, match="expert.kind: ppo.*myo/reach"):
        train(ExpertRequest(task=TaskConfig(name="myo/pose")), {}, context(tmp_path))


def test_shipped_cards_belong_to_their_weights_and_hold_what_they_claim():
    folders = sorted(path.parent for path in zoo.ROOT.glob("*/card.json"))
    assert len(folders) >= 3
    for folder in folders:
        content = card.check(folder)
        final = content["success"]["final"]
        assert content["episodes"] >= 200 and final["low"] < final["rate"] == final["successes"] / content["episodes"]
        request = ExpertRequest.model_validate_json((folder / "request.json").read_text())
        assert content["settings"].items() <= request.expert.model_dump().items()
        assert content["algorithm"] == request.expert.algorithm
        assert request.expert.reward_weights == content["reward_weights"]
        assert sum(path.stat().st_size for path in folder.rglob("*")) < 2e6


# -- the stages ------------------------------------------------------------------------------------


def context(folder, name="out"):
    out, state = folder / name, folder / f"{name}-state"
    out.mkdir(parents=True), state.mkdir()
    stream = open(folder / f"{name}.log", "w")
    return Context(out, state, Metrics(folder / f"{name}.jsonl"), Progress(stream), torch.device("cpu"))


def test_the_zoos_expert_and_card_are_copied_and_the_card_is_measured_where_it_does_not_serve(entry, tmp_path):
    task = TaskConfig(name="myo/reach")
    made = context(tmp_path, "expert")
    train(ExpertRequest(task=task), {}, made)
    assert sorted(path.name for path in made.out.iterdir()) == sorted(zoo.POLICY)
    shipped = json.loads((entry / "card.json").read_text())
    few = context(tmp_path, "few")
    measure(CardRequest(task=task, card={"episodes": 500}), {"expert": made.out}, few)
    few.metrics.flush()
    assert json.loads((few.out / "card.json").read_text()) == shipped
    assert (few.out / "curve.csv").read_bytes() == (entry / "curve.csv").read_bytes()
    assert [row["final"] for row in read(few.metrics.path)][-1] > 0.9
    nominal = context(tmp_path, "nominal")
    measure(
        CardRequest(task=TaskConfig(name=task.name, start="nominal"), card={"episodes": 1}),
        {"expert": made.out},
        nominal,
    )
    content = json.loads((nominal.out / "card.json").read_text())
    assert (content["start"], content["episodes"], content["algorithm"]) == ("nominal", 1, "DAgger")
    assert content["settings"] == shipped["settings"] and content["sha256"] == shipped["sha256"]
    (made.out / zoo.POLICY[0]).write_bytes(b"other")
    with pytest.raises(ValueError, match="is not the expert.*start the workflow again"):
        measure(CardRequest(task=task), {"expert": made.out}, context(tmp_path, "other"))


def test_a_trained_experts_card_says_how_it_was_trained(tmp_path):
    request, made, done = small("sac"), context(tmp_path, "expert"), context(tmp_path, "card")
    train(request, {}, made)
    assert sorted(path.name for path in made.out.iterdir()) == sorted([*zoo.POLICY, *zoo.CRITIC, "curve.csv"])
    measure(CardRequest(task=request.task, expert=request.expert, card={"episodes": 2}), {"expert": made.out}, done)
    content = json.loads((done.out / "card.json").read_text())
    assert (content["algorithm"], content["episodes"], content["settings"]["batch"]) == ("SAC", 2, 8)
    assert (
        content["critic_sha256"] == file_digest(made.out / zoo.CRITIC[0])
        and "checkpoint_every" not in content["settings"]
    )
    assert (done.out / "curve.csv").read_bytes() == (made.out / "curve.csv").read_bytes()


def test_success_counts_with_wilsons_interval():
    """8 of 10 have [0.490, 0.943]; all of 10 have a width, too."""
    rows = [{"final": i < 8, "held": True, "once": False} for i in range(10)]
    result = card.success(rows)
    assert result["final"] == pytest.approx({"successes": 8, "rate": 0.8, "low": 0.4902, "high": 0.9433}, abs=1e-4)
    assert result["held"]["high"] == 1.0 and result["held"]["low"] == pytest.approx(0.7225, abs=1e-4)
    assert result["once"]["low"] == 0.0 and result["once"]["high"] == pytest.approx(1 - 0.7225, abs=1e-4)
    for counts in ((1, 0), (-1, 3), (4, 3)):
        with pytest.raises(ValueError, match="at least one episode"):
            wilson(*counts)
