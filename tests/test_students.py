"""Contracts of every kind of student with every kind of guidance; of codebook, critic guidance, rounds and acting."""

import json
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
import synthetic
import torch
from pydantic import ValidationError
from safetensors.torch import load_file
from torch import Tensor

from acgd.critics.aggregate import AggregateCritic
from acgd.guidance.critic.guidance import CriticGuidance, distill, gates, step_weights
from acgd.guidance.critic.settings import CriticGuidanceConfig
from acgd.guidance.guidance import gradient_ratios, load_guidance
from acgd.guidance.kinds import GUIDANCE
from acgd.nn.excitation import stretched_excitation
from acgd.nn.normaliser import Normaliser
from acgd.nn.q_ensemble import Critic
from acgd.rollouts.dataset import Demonstrations
from acgd.store import metrics
from acgd.store.stage import Context
from acgd.students.acgd import losses, quantizer
from acgd.students.acgd.fit_codebook import fit
from acgd.students.acgd.model import ACGD, Codebook
from acgd.students.acgd.quantizer import Quantizer
from acgd.students.acgd.settings import ACGDConfig
from acgd.students.act import losses as act_losses
from acgd.students.act.settings import ACTConfig
from acgd.students.acting import ChunkPolicy
from acgd.students.data import Batch, Data, Observation
from acgd.students.decoder import ActionDecoder
from acgd.students.distil import distil, start, validate
from acgd.students.ensembling import ensemble
from acgd.students.inputs import StudentInputs
from acgd.students.kinds import STUDENTS
from acgd.students.load import load_policy, load_student, new_student, policy_of, save_student
from acgd.students.settings import ActingConfig, ImitationConfig, StudentRequest
from acgd.students.student import Sizes, Student
from acgd.students.training import learning_rate, log_every
from acgd.students.training_settings import TrainingConfig
from acgd.tasks.settings import TaskConfig

CPU = torch.device("cpu")
STATES = (9, 12)

every_student = pytest.mark.parametrize("kind", STUDENTS)
every_guidance = pytest.mark.parametrize("guided_by", GUIDANCE)


def generator(seed: int = 0) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def streams(seed: int = 1) -> dict[str, torch.Generator]:
    return {"data": generator(seed), "sample": generator(seed + 1)}


@pytest.fixture(scope="module")
def rollouts(tmp_path_factory) -> list[Path]:
    root = tmp_path_factory.mktemp("rollouts")
    return [synthetic.rollouts(root / str(i), i, state=STATES[i]) for i in range(2)]


@pytest.fixture(scope="module")
def onpolicy(tmp_path_factory) -> list[Path]:
    """Two rounds of two tasks, round by round."""
    root = tmp_path_factory.mktemp("onpolicy")
    places = [(turn, i) for turn in (1, 2) for i in range(2)]
    return [synthetic.rollouts(root / f"{t}-{i}", i, episodes=3, state=STATES[i], seed=t) for t, i in places]


@pytest.fixture(scope="module")
def critics(tmp_path_factory) -> list[Path]:
    root = tmp_path_factory.mktemp("critics")
    return [synthetic.critic(root / str(i), STATES[i], seed=i) for i in range(2)]


@pytest.fixture(scope="module")
def qualities(tmp_path_factory) -> list[Path]:
    root = tmp_path_factory.mktemp("qualities")
    return [synthetic.quality(root / str(i), low) for i, low in enumerate((0.4, 0.1))]


@pytest.fixture(scope="module")
def codebook_dir(rollouts, tmp_path_factory) -> Path:
    inputs = {"rollouts": rollouts, "features": rollouts}
    return run(fit, synthetic.codebook_request(), inputs, tmp_path_factory.mktemp("codebook"))


@pytest.fixture(scope="module")
def inputs(rollouts, codebook_dir, critics, qualities) -> dict:
    """Everything that any kind reads."""
    return {
        "rollouts": rollouts,
        "features": rollouts,
        "codebook": codebook_dir,
        "critic": critics,
        "quality": qualities,
    }


def run(stage, request, inputs, directory: Path) -> Path:
    ctx = synthetic.context(directory)
    stage(request, inputs, ctx)
    ctx.metrics.flush()
    return ctx.out


def read_by(request: StudentRequest, inputs: dict) -> dict:
    """The inputs that the plan gives: those that the request uses."""
    return {role: path for role, path in inputs.items() if role == "rollouts" or request.uses(role)}


def distilled(request: StudentRequest, inputs: dict, directory: Path) -> Path:
    return run(distil, request, read_by(request, inputs), directory)


def loaded_data(inputs: dict, kind: str = "acgd", **imitation) -> Data:
    """The windows of that kind of student, with states."""
    settings = synthetic.student_request(kind).student
    return Data.load(
        inputs,
        ImitationConfig(**imitation),
        chunk=settings.chunk,
        history=settings.history,
        states=True,
        device=CPU,
        recurrent=settings.recurrent,
    )


def prepared(kind: str, inputs: dict) -> tuple[Student, Data]:
    """A student before its first step, and its data with its targets."""
    data = loaded_data(inputs, kind)
    student = start(synthetic.student_request(kind), data, inputs, CPU)
    return student, data.with_targets(student.prepare(data, inputs))


@pytest.fixture
def data(inputs) -> Data:
    return loaded_data(inputs)


@pytest.fixture
def student(inputs) -> ACGD:
    return prepared("acgd", inputs)[0]


@pytest.fixture
def guidance(critics) -> CriticGuidance:
    return CriticGuidance(AggregateCritic([Critic.load(c) for c in critics], 1.0), torch.ones(2), torch.ones(4))


# --- losses, against values computed by hand ------------------------------------------------------------------


def test_l_act_is_the_mean_over_valid_steps_of_the_one_norm():
    decoded = torch.tensor([[[1.0, 0.0], [0.5, -0.5], [9.0, 9.0]]])
    mask = torch.tensor([[True, True, False]])
    assert losses.act(decoded, torch.zeros_like(decoded), mask).tolist() == [(1.0 + 1.0) / 2]


def test_l_code_by_hand_and_its_gradient_is_not_zero():
    logits = torch.log(torch.tensor([[[0.7, 0.2, 0.1]]])).requires_grad_()
    straight_through, codes = quantizer.sample(logits, generator())
    loss = losses.code(logits, quantizer.onehot(torch.zeros_like(codes), 3)).sum()
    assert loss.item() == pytest.approx(0.3 + 0.2 + 0.1)
    (gradient,) = torch.autograd.grad(loss, logits)
    # d/dz of 2 (1 - p_0) is -2 p_0 (onehot - p)
    assert gradient.flatten().tolist() == pytest.approx([-2 * 0.7 * 0.3, 2 * 0.7 * 0.2, 2 * 0.7 * 0.1])
    (through,) = torch.autograd.grad(losses.code(logits, straight_through).sum(), logits)
    assert through.abs().max() > 0.01  # also with the one-hot that carries a gradient


def test_l_lat_by_hand():
    logits = torch.log(torch.tensor([[[0.5, 0.5], [0.9, 0.1]]]))
    expected = -(np.log(0.5) + np.log(0.1)) / 2
    assert losses.lat(logits, torch.tensor([[0, 1]])).item() == pytest.approx(expected)


def test_usage_is_zero_for_even_and_log_n_for_a_single_code():
    even = torch.full((4, 1, 8), 0.0)
    one = torch.zeros(4, 1, 8)
    one[..., 3] = 100
    assert losses.usage(even).item() == pytest.approx(0, abs=1e-6)
    assert losses.usage(one).item() == pytest.approx(np.log(8), abs=1e-5)


def test_l_distill_by_hand():
    q = torch.tensor([[1.0, 3.0, 100.0]])
    mask = torch.tensor([[True, True, False]])
    assert distill(q, mask, step_weights("chunk", 3, q.device)).tolist() == [-2.0]
    assert distill(q, mask, step_weights("first", 3, q.device)).tolist() == [-1.0]


def test_excitation_is_what_myosuite_makes_of_an_action():
    a = torch.tensor([-1.0, 0.0, 1.0])
    u = 1 / (1 + torch.exp(-5 * (a - 0.5)))
    stretched = 2 * (u - u[0]) / (u[2] - u[0]) - 1
    assert torch.allclose(stretched_excitation(a), stretched, atol=1e-6)


# --- quantizer ------------------------------------------------------------------------------------------------


def test_sampling_follows_the_softmax_and_evaluation_takes_the_argmax():
    logits = torch.log(torch.tensor([0.6, 0.3, 0.1])).expand(20000, 1, 3)
    _, codes = quantizer.sample(logits, generator())
    assert torch.allclose(quantizer.onehot(codes, 3).mean(0)[0], torch.tensor([0.6, 0.3, 0.1]), atol=0.02)
    assert quantizer.most_likely(logits)[1].unique().tolist() == [0]


def test_straight_through_is_one_hot_forward_and_softmax_backward():
    logits = torch.randn(5, 2, 4, generator=generator()).requires_grad_()
    onehot, codes = quantizer.sample(logits, generator())
    assert torch.allclose(onehot, quantizer.onehot(codes, 4), atol=1e-6)
    weights = torch.randn(5, 2, 4, generator=generator(1))
    straight = torch.autograd.grad((onehot * weights).sum(), logits)[0]
    soft = torch.autograd.grad((logits.softmax(-1) * weights).sum(), logits)[0]
    assert torch.allclose(straight, soft, atol=1e-6)


def test_z_q_is_the_sum_of_the_chosen_embeddings():
    book = Quantizer(ACGDConfig(groups=3, codes=4, width=5, heads=1))
    codes = torch.tensor([[0, 2, 3]])
    assert torch.allclose(
        book.embed(quantizer.onehot(codes, 4))[0], book.codes[0, 0] + book.codes[1, 2] + book.codes[2, 3]
    )


def test_distances_as_logits_choose_the_nearest_code():
    book = Quantizer(ACGDConfig(groups=2, codes=6, width=3, heads=1, logits="distance"))
    z_e = torch.randn(7, 2, 3, generator=generator())
    distance = (z_e[:, :, None] - book.codes).square().sum(-1)
    assert torch.allclose(book.logits(z_e), -distance, atol=1e-5)
    assert book.encoding_size == 3


def test_perplexity_counts_codes_in_use():
    codes = torch.tensor([[0, 5], [1, 5], [2, 5], [3, 5]])
    assert quantizer.perplexity(codes, 8).tolist() == pytest.approx([4.0, 1.0])


# --- data -----------------------------------------------------------------------------------------------------


def test_windows_align_chunk_history_and_states_by_step(data):
    """In the synthetic demonstrations proprio[0] is t / 10 and the action a function of t: an off-by-one shows."""
    t = data.windows.training[[0, 3, 17]]
    batch = data.batch(t, generator())
    reference = data.reference(batch)
    step = (t - data.windows.start[t]).float()
    expected = torch.stack([(step - j).clamp(min=0) for j in (2, 1, 0)], 1) / 10
    assert torch.allclose(batch.observation.proprio[:, :, 0], expected)
    for j in range(data.k):
        inside = step + j < (data.windows.end - data.windows.start)[t]
        assert batch.mask[:, j].tolist() == inside.tolist()
        at = torch.minimum(t + j, data.windows.end[t] - 1)
        assert torch.equal(batch.chunk[:, j], data.windows.steps["label"][at])
        assert torch.equal(reference.states[:, j], data.windows.steps["state"][at])


def test_batches_are_balanced_and_hold_training_episodes_and_goals_of_the_own_task(data):
    t = data.sample(31, generator())
    task = data.windows.task[t]
    assert (task.bincount() - 15.5).abs().max() <= 0.5 and task[:6].tolist() == [0, 1] * 3
    assert torch.isin(t, data.windows.training).all() and not torch.isin(t, data.windows.validation).any()
    goal = data.batch(t, generator()).observation.goal
    for row, own in zip(goal, task):
        (episode,) = (data.windows.episodes["goal"] == row).all(-1).nonzero().flatten().tolist()
        assert data.windows.episode_task[episode] == own and episode in data.goals[own]


def test_goal_image_own_and_off(inputs):
    for setting in ("own", "off"):
        data = loaded_data(inputs, goal=setting)
        t = data.sample(8, generator())
        goal = data.batch(t, generator()).observation.goal
        if setting == "off":
            assert goal is None
        else:
            assert torch.equal(goal, data.windows.episodes["goal"][data.windows.episode[t]])


def test_labels_are_the_mean_or_the_executed_action(inputs, rollouts):
    for label, name in (("mean", "mean_action"), ("executed", "action")):
        data = loaded_data(inputs, label=label)
        stored = [Demonstrations.load(directory, [name]).arrays[name] for directory in rollouts]
        assert np.array_equal(data.windows.steps["label"].numpy(), np.concatenate(stored))


def test_normaliser_does_not_blow_up_what_never_moved():
    x = torch.randn(100, 3, generator=generator())
    x[:, 2] = 1 + 1e-9 * torch.randn(100, generator=generator())
    normaliser = Normaliser(3)
    normaliser.fit(x)
    assert normaliser(x)[:, :2].std(0).tolist() == pytest.approx([1, 1], abs=0.05)
    assert normaliser(x + 0.01).abs().max() <= 5 and normaliser(x)[:, 2].abs().max() < 0.1


# --- contracts of every student and every guidance ------------------------------------------------------------


def test_every_kind_has_a_tiny_form_here():
    assert set(synthetic.STUDENTS) == set(STUDENTS) and set(synthetic.GUIDANCE) == set(GUIDANCE)


def test_a_request_says_what_it_reads():
    def uses(**settings) -> set[str]:
        request = synthetic.student_request(**settings)
        stages = ("features", "codebook", "critic", "quality", "student", "onpolicy", "onpolicy_features")
        return {stage for stage in stages if request.uses(stage)}

    assert uses(kind="acgd") == {"features", "codebook"}
    assert uses(kind="bc") == uses(kind="act") == uses(kind="chunk") == {"features"}
    assert uses(kind="bc", guidance={"kind": "critic"}) == {"features", "critic"}
    assert uses(kind="bc", guidance={"kind": "critic", "gate": "reliable"}) == {"features", "critic", "quality"}
    later = {"student", "onpolicy", "onpolicy_features"}
    assert uses(kind="acgd", round=1, rounds={"count": 2}) == {"features", "codebook"} | later


def test_a_kind_refuses_the_fields_of_another():
    with pytest.raises(ValidationError):
        synthetic.student_request("bc", chunk=4)
    with pytest.raises(ValidationError):
        synthetic.student_request(guidance={"kind": "none", "alpha": 1.0})


LEARNING = {"steps": 250, "batch": 64, "validate_every": 50, "learning_rate": 3e-3, "input_noise": 0.0}


@pytest.fixture(scope="module")
def learned_codebook(inputs, tmp_path_factory) -> Path:
    request = synthetic.codebook_request(training=LEARNING)
    return run(fit, request, inputs, tmp_path_factory.mktemp("learned-codebook"))


def test_a_codebook_learns_a_small_dataset_and_its_codes_carry_the_chunk(learned_codebook):
    health = json.loads((learned_codebook / "health.json").read_text())
    assert health["reconstruction"]["training"] < 0.1 and health["shuffled_ratio"] > 2


@every_student
@every_guidance
def test_a_student_learns_a_small_dataset(kind, guided_by, inputs, learned_codebook, tmp_path):
    training = LEARNING | synthetic.TRAINING.get(kind, {})
    inputs = inputs | {"codebook": learned_codebook}
    guidance = synthetic.GUIDANCE[guided_by] | ({"gate": "reliable"} if guided_by == "critic" else {})
    out = distilled(synthetic.student_request(kind, guidance, training), inputs, tmp_path / "student")
    card = json.loads((out / "student.json").read_text())
    assert (card["kind"], card["guidance"]["kind"], card["tasks"]) == (kind, guided_by, list(synthetic.TASKS))
    rows = metrics.read(out / "metrics.jsonl")
    assert {"l_act", "validation_plan_error", "validation_loss"} <= rows[-1].keys()
    assert rows[-1]["l_act"] < rows[0]["l_act"]
    if guided_by == "critic":
        open_, closed = (card["guidance"]["tasks"][name] for name in synthetic.TASKS)
        assert open_["gate"] == 1 and open_["counts_as_guidance"]
        assert closed == {"gate": 0, "gradient_ratio": 0, "counts_as_guidance": False}
        assert {"l_distill", "guidance_ratio/myo/reach", "validation_gain"} <= rows[-1].keys()
    else:
        assert card["guidance"] == {"kind": "none"} and not {"l_distill", "validation_gain"} & rows[-1].keys()

    data, learned = loaded_data(inputs, kind), load_student(out, "last", CPU)
    batch = data.batch(data.windows.training, generator())
    error = losses.act(learned.plan(batch.observation), batch.chunk, batch.mask).mean() / synthetic.A
    assert error < 0.2 < batch.chunk.abs().mean()  # predicting nothing would err by the labels' mean size


@every_student
@every_guidance
def test_gradient_of_guidance_reaches_the_student_and_leaves_the_critic(kind, guided_by, inputs):
    student, data = prepared(kind, inputs)
    settings = synthetic.student_request(kind, synthetic.GUIDANCE[guided_by]).guidance
    guidance = load_guidance(settings, inputs, chunk=data.k, device=CPU)
    if guidance is None:
        return
    before = {name: value.clone() for name, value in guidance.critic.state_dict().items()}
    batch = data.batch(data.sample(16, generator()), generator())
    imitation = student.imitate(batch, guided=16, noise=0.0, generators=streams())
    guidance.loss(imitation.proposal, data.reference(batch)).mean().backward()
    assert sum(p.grad.abs().sum() for p in student.parameters() if p.grad is not None) > 0
    assert not any(p.grad is not None for p in guidance.critic.parameters())
    assert all(torch.equal(value, before[name]) for name, value in guidance.critic.state_dict().items())


@every_student
def test_shapes_of_the_interface(kind, inputs):
    student, data = prepared(kind, inputs)
    batch = data.batch(data.sample(16, generator()), generator())
    alone, guided = (student.imitate(batch, guided=n, noise=0.1, generators=streams()) for n in (0, 5))
    assert alone.loss.shape == (16,) and alone.proposal is None
    assert guided.proposal.shape == (5, data.k, synthetic.A) and guided.proposal.abs().max() < 1
    # the same noise, whether guided or not
    assert torch.allclose(alone.loss, guided.loss, atol=1e-5)
    assert all(value.shape == (16,) for value in guided.metrics.values())
    student.eval()
    assert all(value.shape == (16,) for value in student.validate(batch).values())
    plan = student.plan(batch.observation)
    assert plan.shape == (16, data.k, synthetic.A) and not plan.requires_grad and plan.abs().max() < 1


@every_student
def test_the_student_cannot_read_the_privileged_state(kind, inputs, critics):
    """Other states: the same actions, the same gradient of L_BC; and no argument could hold them."""
    student, data = prepared(kind, inputs)
    assert not {"state", "states"} & ({f.name for f in fields(Observation)} | {f.name for f in fields(Batch)})
    settings = synthetic.student_request(kind, {"kind": "critic"}).guidance
    guidance = load_guidance(settings, inputs, chunk=data.k, device=CPU)
    t = data.sample(16, generator())
    outcomes = []
    for scale in (1.0, -100.0):
        steps = data.windows.steps | {"state": data.windows.steps["state"] * scale}
        changed = replace(data, windows=replace(data.windows, steps=steps))
        batch = changed.batch(t, generator(3))
        student.zero_grad()
        imitation = student.imitate(batch, guided=16, noise=0.0, generators=streams())
        l_distill = guidance.loss(imitation.proposal, changed.reference(batch)).detach()
        imitation.loss.mean().backward()
        gradients = [p.grad.clone() for p in student.parameters() if p.grad is not None]
        outcomes.append((student.plan(batch.observation), gradients, l_distill))
    (plan, gradients, l_distill), (other_plan, other_gradients, other_l_distill) = outcomes
    assert torch.equal(plan, other_plan)
    assert all(torch.equal(a, b) for a, b in zip(gradients, other_gradients, strict=True))
    assert not torch.equal(l_distill, other_l_distill)  # the critic, though, did read them


@every_student
def test_the_policy_passes_on_neither_state_nor_anything_else(kind, inputs):
    student, _ = prepared(kind, inputs)
    read = []

    class Spy:
        def start(self, tasks, goals, seeds):
            return None

        def act(self, obs, memory):
            read.append(set(obs))
            return np.zeros((2, synthetic.A)), memory

    student.policy = lambda acting: Spy()
    policy = policy_of(student, Pixels(), ActingConfig(), tasks=synthetic.TASKS, rows=2)
    obs = {"image": np.zeros((2, 4, 4, 3), np.uint8), "proprio": np.zeros((2, synthetic.P)), "state": np.zeros((2, 9))}
    policy.act(obs, policy.start(np.zeros(2, np.int64), np.zeros((2, 4, 4, 3), np.uint8), [0, 1]))
    assert read == [{"vision", "proprio"}]


@every_student
def test_masked_steps_reach_no_loss(kind, inputs):
    student, data = prepared(kind, inputs)
    settings = synthetic.student_request(kind, {"kind": "critic"}).guidance
    guidance = load_guidance(settings, inputs, chunk=data.k, device=CPU)
    t = data.windows.end[data.windows.training][:8] - 1  # the last step of an episode: one valid step
    batch = data.batch(t, generator())
    assert batch.mask.sum() == 8

    def all_losses(batch: Batch, states: Tensor) -> list[Tensor]:
        imitation = student.imitate(batch, guided=8, noise=0.0, generators=streams())
        reference = replace(data.reference(batch), states=states)
        return [imitation.loss, guidance.loss(imitation.proposal, reference)]

    chunk, states = batch.chunk.clone(), data.reference(batch).states.clone()
    chunk[:, 1:], states[:, 1:] = 0.77, 50.0
    before = all_losses(batch, data.reference(batch).states)
    after = all_losses(replace(batch, chunk=chunk), states)
    assert all(torch.allclose(a, b) for a, b in zip(before, after, strict=True))


@every_student
def test_a_saved_student_is_loaded_as_it_was(kind, inputs, tmp_path):
    student, data = prepared(kind, inputs)
    save_student(student, tmp_path, {"best": student.state_dict()}, {"tasks": list(synthetic.TASKS)})
    loaded = load_student(tmp_path, "best", CPU)
    assert type(loaded) is type(student) and loaded.settings == student.settings and loaded.sizes == student.sizes
    seen = data.batch(data.sample(8, generator()), generator()).observation
    assert torch.equal(loaded.plan(seen), student.eval().plan(seen)) and not loaded.training


class Killed(Exception):
    pass


class KillingMetrics(metrics.Metrics):
    """Dies at a step, its rows on the disk or not as the flushes would have it."""

    at = 5

    def log(self, step: int, **values: float) -> None:
        super().log(step, **values)
        if step >= self.at:
            raise Killed


def assert_same_files(one: Path, other: Path) -> None:
    names = sorted(p.name for p in one.iterdir())
    assert sorted(p.name for p in other.iterdir()) == names and len(names) >= 4
    for name in names:
        assert (one / name).read_bytes() == (other / name).read_bytes(), name


def interrupted(stage, request, inputs, directory: Path) -> Path:
    """Killed at step 5, and run again."""
    ctx = synthetic.context(directory)
    killing = KillingMetrics(ctx.out / "metrics.jsonl")
    with pytest.raises(Killed):
        stage(request, inputs, Context(ctx.out, ctx.state, killing, ctx.progress, ctx.device))
    assert (ctx.state / "checkpoint.safetensors").exists()
    return run(stage, request, inputs, directory)


@every_student
@every_guidance
def test_an_interruption_changes_no_byte(kind, guided_by, inputs, tmp_path):
    request = synthetic.student_request(kind, synthetic.GUIDANCE[guided_by])
    read = read_by(request, inputs)
    whole = run(distil, request, read, tmp_path / "whole")
    assert_same_files(whole, interrupted(distil, request, read, tmp_path / "cut"))


def test_an_interruption_changes_no_byte_of_a_codebook(inputs, tmp_path):
    request = synthetic.codebook_request()
    whole = run(fit, request, inputs, tmp_path / "whole")
    assert_same_files(whole, interrupted(fit, request, inputs, tmp_path / "cut"))


@every_student
def test_a_student_that_owns_its_cnn_reads_images(kind, critics, tmp_path):
    rollouts = [synthetic.rollouts(tmp_path / f"r{i}", i, episodes=3, state=STATES[i], images=True) for i in range(2)]
    inputs = {"rollouts": rollouts, "critic": critics, "backbone": synthetic.backbone(tmp_path / "backbone")}
    few = {"steps": 2, "batch": 4}
    if kind == "acgd":
        inputs["codebook"] = run(fit, synthetic.codebook_request(training=few), inputs, tmp_path / "codebook")
    request = synthetic.student_request(kind, {"kind": "critic"}, few)
    out = run(distil, request, inputs, tmp_path / "student")
    weights = load_file(out / "last.safetensors")
    (name,) = [name for name in weights if name.endswith("cnn.mix.0.weight")]
    fresh = start(request, loaded_data(inputs, kind), inputs, CPU).state_dict()
    assert not torch.equal(weights[name], fresh[name])
    policy = load_policy(out, inputs["backbone"], ActingConfig(), CPU, rows=2)
    images = np.zeros((2, 32, 32, 3), np.uint8)
    obs = {"image": images, "proprio": np.zeros((2, synthetic.P))}
    actions, _ = policy.act(obs, policy.start(np.array([0, 1]), images, [0, 1]))
    assert actions.shape == (2, synthetic.A)


@every_student
@every_guidance
@pytest.mark.parametrize("size", ["two windows a batch", "one demonstration", "episodes shorter than a chunk"])
def test_the_smallest_settings_train(kind, guided_by, size, critics, tmp_path):
    few = {"one demonstration": 1}.get(size, 4)
    length = 5 if size == "episodes shorter than a chunk" else 20
    rollouts = [
        synthetic.rollouts(tmp_path / f"r{i}", i, episodes=few, length=length, state=STATES[i]) for i in range(2)
    ]
    inputs = {"rollouts": rollouts, "features": rollouts, "critic": critics}
    training, student = {"batch": 2}, {"bc": {}, "bc_rnn": {"sequence": 12}}.get(kind, {"chunk": 12, "history": 9})
    if kind == "acgd":
        book = synthetic.codebook_request(training=training, **student)
        inputs["codebook"] = run(fit, book, inputs, tmp_path / "codebook")
    request = synthetic.student_request(kind, synthetic.GUIDANCE[guided_by], training, **student)
    rows = metrics.read(distilled(request, inputs, tmp_path / "student") / "metrics.jsonl")
    assert np.isfinite([rows[-1]["loss"], rows[-1]["validation_plan_error"]]).all()


@every_student
def test_validation_leaves_training_untouched(kind, inputs):
    student, data = prepared(kind, inputs)
    state = torch.random.get_rng_state()
    first, second = (validate(student, data, None) for _ in range(2))
    assert first == second and student.training and torch.equal(state, torch.random.get_rng_state())


@every_student
def test_last_weights_and_best_weights_are_both_kept(kind, inputs, tmp_path):
    # diverges, so that best is not last
    training = {"steps": 4, "validate_every": 2, "learning_rate": 1.0, "clip_norm": 1e9, "warmup": 0}
    out = distilled(synthetic.student_request(kind, training=training), inputs, tmp_path)
    best, last = (load_file(out / f"{name}.safetensors") for name in ("best", "last"))
    step = json.loads((out / "student.json").read_text())["best"]["step"]
    assert all(torch.equal(best[name], last[name]) for name in best) == (step == 4)


@every_student
def test_a_seed_gives_other_weights(kind, inputs, tmp_path):
    zero, again, one = (
        distilled(synthetic.student_request(kind, seed=seed), inputs, tmp_path / str(i)) / "last.safetensors"
        for i, seed in enumerate((0, 0, 1))
    )
    assert zero.read_bytes() == again.read_bytes() != one.read_bytes()


# --- the student of the paper ---------------------------------------------------------------------------------


def test_gradient_of_q_reaches_the_latent_encoder_through_the_sample(inputs, guidance):
    student, data = prepared("acgd", inputs)
    batch = data.batch(data.sample(16, generator()), generator())
    imitation = student.imitate(batch, guided=16, noise=0.0, generators=streams())
    guidance.loss(imitation.proposal, data.reference(batch)).mean().backward()
    for part in (student.latent_encoder, student.decoder, student.observer):
        assert sum(p.grad.abs().sum() for p in part.parameters() if p.grad is not None) > 0
    assert student.latent_encoder.net[-1].weight.grad.abs().max() > 0
    assert student.quantizer.codes.grad is None


def test_codes_of_a_chunk_do_not_depend_on_what_lies_past_the_end(codebook_dir):
    codebook = Codebook.load(codebook_dir, CPU)
    chunk, mask = torch.zeros(1, 4, synthetic.A), torch.tensor([[True, True, False, False]])
    other = chunk.clone()
    other[:, 2:] = 1
    assert torch.equal(codebook.encode(chunk, mask), codebook.encode(other, mask))


def test_actions_stay_strictly_inside_the_box_with_a_gradient():
    torch.manual_seed(0)
    settings = ACGDConfig(chunk=4, width=16, heads=2)
    decoder = ActionDecoder(settings, Sizes(features=1, proprio=1, actions=5, tasks=1, owns_cnn=False))
    z = torch.randn(3, 16, requires_grad=True)
    chunk = decoder(z, z, z)
    assert chunk.shape == (3, 4, 5) and chunk.abs().max() < 1
    with torch.no_grad():
        decoder.head.bias.fill_(3.0)
    chunk = decoder(z, z, z)
    chunk.sum().backward()
    assert chunk.abs().max() < 1 and z.grad.abs().max() > 0


def test_codebook_artifact_and_health(codebook_dir):
    files = {"codebook.json", "codebook.safetensors", "health.json", "metrics.jsonl"}
    assert {p.name for p in codebook_dir.iterdir()} == files
    health = json.loads((codebook_dir / "health.json").read_text())
    assert len(health["perplexity"]) == 2 and all(1 <= p <= 8 for p in health["perplexity"])
    assert health["reconstruction"]["validation"] > 0 and health["shuffled"]["validation"] > 0


def test_a_seed_changes_the_codebook(inputs, codebook_dir, tmp_path):
    books = [run(fit, synthetic.codebook_request(seed), inputs, tmp_path / f"{seed}") for seed in (0, 1)]
    same, other = (load_file(b / "codebook.safetensors")["quantizer.codes"] for b in books)
    first = load_file(codebook_dir / "codebook.safetensors")["quantizer.codes"]
    assert torch.equal(same, first) and not torch.equal(same, other)


def test_the_codes_stay_those_of_the_codebook(inputs, tmp_path):
    out = distilled(synthetic.student_request(), inputs, tmp_path)
    codes = load_file(inputs["codebook"] / "codebook.safetensors")["quantizer.codes"]
    assert torch.equal(load_file(out / "last.safetensors")["quantizer.codes"], codes)


@pytest.mark.parametrize(
    ("student", "imitation", "training"),
    [
        ({"logits": "distance"}, {}, {}),
        ({}, {"action_space": "excitation"}, {}),
        ({}, {"goal": "off"}, {}),
        ({}, {}, {"precision": "bfloat16"}),
    ],
)
def test_options_train_save_and_load(student, imitation, training, inputs, tmp_path):
    book = synthetic.codebook_request(training=training, imitation=imitation, **student)
    inputs = inputs | {"codebook": run(fit, book, inputs, tmp_path / "codebook")}
    guidance = {"kind": "critic", "guided_steps": "first"}
    request = synthetic.student_request("acgd", guidance, training, imitation, **student)
    out = distilled(request, inputs, tmp_path / "student")
    goal = None if request.imitation.goal == "off" else torch.zeros(3, synthetic.F)
    seen = Observation(torch.zeros(3, synthetic.F), goal, torch.zeros(3, 3, synthetic.P), torch.tensor([0, 1, 0]))
    chunk = load_student(out, "best", CPU).plan(seen)
    assert chunk.shape == (3, 4, synthetic.A) and chunk.abs().max() < 1 and torch.isfinite(chunk).all()


def test_heads_that_do_not_divide_the_width_are_refused():
    with pytest.raises(ValueError, match="width 130 is no multiple of heads 4"):
        ACGDConfig(width=130)


# --- ACT and the chunk without codes --------------------------------------------------------------------------


def test_kl_by_hand():
    mean, log_variance = torch.tensor([[1.0, 0.0]]), torch.log(torch.tensor([[1.0, 4.0]]))
    # 0.5 (mu^2 + sigma^2 - log sigma^2 - 1): 0.5 for the first component, 0.5 (4 - log 4 - 1) for the second
    expected = 0.5 + 0.5 * (3 - np.log(4))
    assert act_losses.kl(mean, log_variance).tolist() == pytest.approx([expected])
    assert act_losses.kl(torch.zeros(3, 2), torch.zeros(3, 2)).tolist() == [0, 0, 0]


def test_z_has_the_moments_of_the_posterior_and_their_gradients():
    mean, log_variance = (torch.full((20000, 1), x, requires_grad=True) for x in (0.5, float(np.log(4.0))))
    z = act_losses.sample(mean, log_variance, generator())
    assert (z.mean().item(), z.std().item()) == pytest.approx((0.5, 2.0), abs=0.05)
    by_mean, by_log_variance = torch.autograd.grad(z.sum(), (mean, log_variance))
    assert torch.equal(by_mean, torch.ones_like(mean))
    assert torch.allclose(by_log_variance, 0.5 * (z - mean).detach(), atol=1e-5)


def test_loss_of_act_is_l1_and_the_weighed_kl_of_its_posterior(inputs):
    student, data = prepared("act", inputs)
    batch = data.batch(data.sample(16, generator()), generator())
    imitation = student.imitate(batch, guided=0, noise=0.0, generators=streams())
    seen = student.inputs(batch.observation)
    mean, log_variance = student.posterior(seen, batch)
    z = act_losses.sample(mean, log_variance, streams()["data"])
    chunk = student.decode(z, student.tokens(seen, batch.observation.task))
    l_act = ((chunk - batch.chunk).abs().sum(-1) * batch.mask).sum(-1) / batch.mask.sum(-1)
    l_kl = (mean.square() + log_variance.exp() - log_variance - 1).sum(-1) / 2
    assert torch.allclose(imitation.loss, l_act + synthetic.A * 10.0 * l_kl, rtol=1e-4)
    assert torch.allclose(imitation.metrics["l_kl"], l_kl, rtol=1e-4) and l_kl.min() > 0


def test_act_plans_by_z_zero_and_its_style_encoder_reads_only_labels_in_training(inputs):
    student, data = prepared("act", inputs)
    seen = data.batch(data.sample(8, generator()), generator()).observation
    tokens = student.tokens(student.inputs(seen), seen.task)
    plan = student.plan(seen)
    assert torch.equal(plan, student.decode(torch.zeros(8, 4), tokens)) and torch.equal(plan, student.plan(seen))
    assert not torch.allclose(plan, student.decode(torch.ones(8, 4), tokens), atol=1e-3)
    with torch.no_grad():
        for p in student.style_encoder.parameters():
            p.fill_(torch.nan)
    assert torch.equal(plan, student.plan(seen))


def test_guidance_of_act_passes_the_prior_and_imitation_the_posterior(inputs, guidance):
    student, data = prepared("act", inputs)
    batch = data.batch(data.sample(16, generator()), generator())

    def gradients(of_guidance: bool) -> dict[str, float]:
        student.zero_grad()
        imitation = student.imitate(batch, guided=16, noise=0.0, generators=streams())
        if of_guidance:
            guidance.loss(imitation.proposal, data.reference(batch)).mean().backward()
        else:
            imitation.metrics["l_act"].mean().backward()
        parts = ("style_encoder", "tokens", "latent", "encoder", "decoder")
        return {
            part: sum(p.grad.abs().sum().item() for p in getattr(student, part).parameters() if p.grad is not None)
            for part in parts
        }

    by_guidance, by_imitation = gradients(True), gradients(False)
    assert by_guidance.pop("style_encoder") == 0 and min(by_guidance.values()) > 0
    assert min(by_imitation.values()) > 0
    # a proposal knows the observation alone: other labels leave it as it is
    proposals = [
        student.imitate(replace(batch, chunk=chunk), guided=16, noise=0.0, generators=streams()).proposal
        for chunk in (batch.chunk, -batch.chunk)
    ]
    assert torch.equal(*proposals)


def test_act_has_one_decoder_layer_as_published_and_uses_every_layer_that_it_has(inputs):
    assert ACTConfig().decoder_layers == 1
    data = loaded_data(inputs, "act")
    request = synthetic.student_request("act", decoder_layers=3)
    student = start(request, data, inputs, CPU)
    batch = data.batch(data.sample(16, generator()), generator())
    student.imitate(batch, guided=0, noise=0.0, generators=streams()).loss.mean().backward()
    assert len(student.decoder.blocks) == 3
    assert all(
        p.grad is not None and p.grad.abs().max() > 0 for p in student.decoder.blocks[2].feedforward.parameters()
    )


def test_a_chunk_without_codes_has_the_parts_of_acgd_and_no_others(inputs):
    acgd, chunk = prepared("acgd", inputs)[0], prepared("chunk", inputs)[0]
    shapes = {
        name: value.shape for name, value in acgd.state_dict().items() if name.startswith(("observer.", "decoder."))
    }
    assert {name: value.shape for name, value in chunk.state_dict().items()} == shapes


# --- critic guidance ------------------------------------------------------------------------------------------


def test_distill_is_the_critics_own_judgement_of_the_proposed_chunk(data, critics):
    """Step j of the chunk with the state of step j, each row by its own task's critic, in spreads."""
    batch = data.batch(data.sample(6, generator()), generator())
    reference = data.reference(batch)
    chunk = torch.rand(6, 4, synthetic.A, generator=generator()) * 2 - 1
    members = [Critic.load(c) for c in critics]
    guidance = CriticGuidance(AggregateCritic(members, 0.0), torch.tensor([1.0, 0.5]), torch.ones(4))
    expected = []
    for row in range(6):
        task = int(batch.observation.task[row])
        own, states = members[task], reference.states[row, :, : STATES[task]]
        q, shown = (
            [own(states[j : j + 1], of[row, j : j + 1]).mean().item() for j in range(4)] for of in (chunk, batch.chunk)
        )
        valid = [(x - y) / own.spread.item() for x, y, inside in zip(q, shown, batch.mask[row]) if inside]
        expected.append(-(1.0, 0.5)[task] * sum(valid) / len(valid))
    assert guidance.loss(chunk, reference).tolist() == pytest.approx(expected, rel=1e-4)


def test_gate_reliable_closes_where_the_interval_reaches_below(inputs, tmp_path):
    assert gates(CriticGuidanceConfig(gate="one"), inputs).tolist() == [1, 1]
    assert gates(CriticGuidanceConfig(gate="reliable"), inputs).tolist() == [1, 0]
    unranked = {"quality": [synthetic.quality(tmp_path / "q", None)]}
    assert gates(CriticGuidanceConfig(gate="reliable"), unranked).tolist() == [0]


def test_at_least_one_window_is_guided(guidance):
    assert replace(guidance, fraction=0.25).rows(64) == 16 and replace(guidance, fraction=0.25).rows(2) == 1


def test_gradient_ratio_is_per_task(inputs):
    student, data = prepared("acgd", inputs)
    batch = data.batch(data.sample(16, generator()), generator())
    bc, task = student.imitate(batch, guided=0, noise=0.0, generators=streams()).loss, batch.observation.task
    guided = bc * torch.where(task == 0, 0.5, 0.0)
    assert gradient_ratios(student, bc, guided, task, 2) == pytest.approx([0.5, 0.0], abs=1e-5)


@every_student
def test_guided_and_unguided_students_see_the_same_batches(kind, inputs, tmp_path):
    first = []
    for guided_by in GUIDANCE:
        request = synthetic.student_request(kind, synthetic.GUIDANCE[guided_by], {"steps": 1})
        first.append(metrics.read(distilled(request, inputs, tmp_path / guided_by) / "metrics.jsonl")[0])
    assert first[0]["l_act"] == pytest.approx(first[1]["l_act"], rel=1e-5)


def test_alpha_weighs_imitation_against_guidance(inputs, tmp_path):
    def ratio(alpha: float) -> float:
        guidance = {"kind": "critic", "alpha": alpha}
        out = distilled(synthetic.student_request("bc", guidance, {"steps": 1}), inputs, tmp_path / str(alpha))
        return json.loads((out / "student.json").read_text())["guidance"]["tasks"]["myo/reach"]["gradient_ratio"]

    assert ratio(5.0) == pytest.approx(2 * ratio(10.0), rel=1e-4)


# --- on-policy rounds -----------------------------------------------------------------------------------------


def later(inputs: dict, onpolicy: list[Path], student: Path) -> dict:
    return inputs | {"onpolicy": onpolicy, "onpolicy_features": onpolicy, "student": student}


def test_on_policy_windows_are_for_training_and_goals_stay_demonstrations(inputs, onpolicy):
    alone, data = loaded_data(inputs), loaded_data(inputs | {"onpolicy": onpolicy, "onpolicy_features": onpolicy})
    windows, demonstrated = data.windows, len(alone.windows.task)
    assert torch.equal(windows.validation, alone.windows.validation)
    assert torch.isin(torch.arange(demonstrated, len(windows.task)), windows.training).all()
    assert len(windows.training) == len(alone.windows.training) + len(windows.task) - demonstrated
    assert [goals.tolist() for goals in data.goals] == [goals.tolist() for goals in alone.goals]
    # round by round, task by task: the states of the second task are wider
    tasks = windows.task[demonstrated:].unique_consecutive().tolist()
    assert tasks == [0, 1, 0, 1] and len(data.by_task) == 2
    wide = windows.steps["state"][:, STATES[0] :].abs().sum(-1) > 0
    assert torch.equal(wide, windows.task == 1)
    for setting in ("own", "any"):
        data = loaded_data(inputs | {"onpolicy": onpolicy, "onpolicy_features": onpolicy}, goal=setting)
        goal = data.batch(torch.arange(demonstrated, len(windows.task)), generator()).observation.goal
        known = windows.episodes["goal"][torch.cat(data.goals)]
        assert all((known == row).all(-1).any() for row in goal)


@pytest.mark.parametrize(("labels", "array", "weight"), [("expert", "mean_action", 1), ("none", "action", 0)])
def test_labels_of_on_policy_windows(labels, array, weight, inputs, onpolicy):
    data = Data.load(
        inputs | {"onpolicy": onpolicy, "onpolicy_features": onpolicy},
        ImitationConfig(),
        chunk=4,
        history=3,
        states=False,
        device=CPU,
        onpolicy_labels=labels,
    )
    stored = np.concatenate([Demonstrations.load(directory, [array]).arrays[array] for directory in onpolicy])
    steps = data.windows.steps
    assert np.array_equal(steps["label"][-len(stored) :].numpy(), stored)
    assert steps["weight"][-len(stored) :].unique().tolist() == [weight]
    assert steps["weight"][: -len(stored)].unique().tolist() == [1]


@every_student
@every_guidance
@pytest.mark.parametrize("labels", ["expert", "none"])
def test_a_round_goes_on_from_the_last_weights(kind, guided_by, labels, inputs, onpolicy, tmp_path):
    guidance = synthetic.GUIDANCE[guided_by]
    before = distilled(synthetic.student_request(kind, guidance), inputs, tmp_path / "0")
    rounds = {"count": 1, "labels": labels, "steps": 6}
    request = synthetic.student_request(kind, guidance, {"validate_every": 1}, rounds=rounds, round=1)
    read = read_by(request, later(inputs, onpolicy, before))
    first = start(request, loaded_data(inputs, kind), read, CPU).state_dict()
    assert all(torch.equal(value, first[name]) for name, value in load_file(before / "last.safetensors").items())
    out = run(distil, request, read, tmp_path / "1")
    card = json.loads((out / "student.json").read_text())
    assert card["round"] == 1 and card["training"]["steps"] == 6
    after = load_file(out / "last.safetensors")
    frozen = [name for name in after if "inputs" in name or name == "quantizer.codes"]
    assert all(torch.equal(after[name], first[name]) for name in frozen) and len(frozen) >= 4
    assert any(not torch.equal(after[name], first[name]) for name in after)
    assert_same_files(out, interrupted(distil, request, read, tmp_path / "cut"))


def test_without_labels_only_guidance_trains_on_visited_states(inputs, onpolicy, rollouts, tmp_path):
    """Batches of on-policy windows alone: nothing moves an unguided student, the critic moves a guided one."""
    request = synthetic.student_request("bc", rounds={"labels": "none"}, round=1)
    data = Data.load(
        {
            "rollouts": onpolicy[:2],
            "features": onpolicy[:2],
            "onpolicy": onpolicy[2:],
            "onpolicy_features": onpolicy[2:],
        },
        request.imitation,
        chunk=1,
        history=1,
        states=True,
        device=CPU,
        onpolicy_labels="none",
    )
    student = start(request, data, {"rollouts": rollouts, "features": rollouts}, CPU)
    visited = torch.nonzero(data.windows.steps["weight"] == 0).flatten()[:16]
    batch = data.batch(visited, generator())
    imitation = student.imitate(batch, guided=16, noise=0.0, generators=streams())
    assert (batch.weight * imitation.loss).abs().max() == 0 and imitation.loss.min() > 0
    guidance = load_guidance(CriticGuidanceConfig(), inputs, chunk=1, device=CPU)
    guidance.loss(imitation.proposal, data.reference(batch)).mean().backward()
    assert max(p.grad.abs().max() for p in student.parameters()) > 0
    assert torch.equal(data.reference(batch).actions[:, 0], data.windows.steps["label"][visited])


def test_a_later_round_needs_its_settings():
    with pytest.raises(ValidationError, match="rounds is for round 1"):
        synthetic.student_request(round=1)
    with pytest.raises(ValidationError, match="rounds is for round 1"):
        synthetic.student_request(rounds={"count": 1})


# --- training -------------------------------------------------------------------------------------------------


def test_schedule_warms_up_and_falls():
    config = TrainingConfig(steps=100, warmup=9, learning_rate=1.0)
    assert learning_rate(0, config) == pytest.approx(0.1)
    assert learning_rate(9, config) == pytest.approx(1.0)
    assert learning_rate(99, config) < 0.02
    assert learning_rate(99, config.model_copy(update={"schedule": "constant"})) == 1.0


def test_a_batch_smaller_than_the_number_of_tasks_is_refused():
    tasks = [TaskConfig(name=name) for name in (*synthetic.TASKS, "myo/key-turn")]
    for request in (
        synthetic.student_request(training={"batch": 2}),
        synthetic.codebook_request(training={"batch": 2}),
    ):
        with pytest.raises(ValidationError, match="batch is 2 for 3 tasks: set it to 3 or more"):
            type(request)(**dict(request) | {"tasks": tasks})


def test_rows_of_metrics_depend_on_the_number_of_steps_alone():
    assert [log_every(steps) for steps in (1, 12, 250, 3000, 100_000)] == [1, 1, 25, 100, 100]


# --- acting ---------------------------------------------------------------------------------------------------


def test_ensembling_weighs_newest_in_the_paper_and_oldest_in_act():
    predictions = np.array([[[1.0], [2.0], [4.0]]])  # newest first
    w = np.exp(-0.5 * np.arange(3))
    paper = (w @ [1, 2, 4]) / w.sum()
    act = (w @ [4, 2, 1]) / w.sum()
    oldest = np.array([2])
    assert ensemble(predictions, oldest, "ensemble-paper", 0.5)[0, 0] == pytest.approx(paper)
    assert ensemble(predictions, oldest, "ensemble-act", 0.5)[0, 0] == pytest.approx(act)
    for mode in ("ensemble-paper", "ensemble-act"):
        assert ensemble(predictions, np.array([0]), mode, 0.5)[0, 0] == 1  # only one prediction made so far
        w2 = np.exp(-0.5 * np.arange(2))
        two = (w2 @ ([1, 2] if mode == "ensemble-paper" else [2, 1])) / w2.sum()
        assert ensemble(predictions, np.array([1]), mode, 0.5)[0, 0] == pytest.approx(two)


class Pixels(torch.nn.Module):
    """A backbone whose features are the mean brightness."""

    def forward(self, images: Tensor) -> Tensor:
        return images.float().mean((1, 2, 3))[:, None].expand(-1, synthetic.F)


class Scripted(torch.nn.Module):
    """A student whose chunk, planned at step t, says 100 t + (t + j) for each of its steps j: its origin is visible."""

    settings = ACGDConfig(chunk=3, history=2)
    imitation = ImitationConfig(goal="off")
    sizes = Sizes(features=4, proprio=1, actions=1, tasks=2, owns_cnn=True)

    def __init__(self) -> None:
        super().__init__()
        self.weight = torch.nn.Parameter(torch.zeros(1))

    def plan(self, observation: Observation) -> Tensor:
        t = observation.proprio[:, -1]
        return (100 * t + t + torch.arange(3))[..., None].float()


def roll(mode: str, steps: int, offsets: tuple[int, ...] = (0,)) -> np.ndarray:
    policy = ChunkPolicy(Scripted(), ActingConfig(mode=mode, eta=0.3))
    memory = policy.start(np.zeros(len(offsets), int), None, [0] * len(offsets))
    taken = []
    for t in range(steps):
        proprio = np.array([[t + offset] for offset in offsets], np.float32)
        action, memory = policy.act({"vision": np.zeros((len(offsets), 2), np.float32), "proprio": proprio}, memory)
        taken.append(action[:, 0])
    return np.array(taken)


def test_first_action_of_each_chunk():
    assert roll("first", 5)[:, 0].tolist() == [101 * t for t in range(5)]


def test_open_loop_executes_whole_chunks():
    assert roll("open-loop", 7)[:, 0].tolist() == [0, 1, 2, 303, 304, 305, 606]


@pytest.mark.parametrize("mode", ["ensemble-paper", "ensemble-act"])
def test_ensembled_actions_average_predictions_for_the_same_step(mode):
    """Every prediction for step t holds t plus 100 times the step it was made at."""
    for t, action in enumerate(roll(mode, 6)[:, 0]):
        made = [t - i for i in range(3) if t - i >= 0]
        order = made if mode == "ensemble-paper" else made[::-1]
        w = np.exp(-0.3 * np.arange(len(made)))
        assert action == pytest.approx(t + 100 * (w @ order) / w.sum(), rel=1e-5)


def test_rows_of_a_memory_do_not_mix():
    both = roll("ensemble-paper", 6, (0, 7))
    assert np.array_equal(both[:, 0], roll("ensemble-paper", 6)[:, 0])
    assert np.array_equal(both[:, 1], roll("ensemble-paper", 6, (7,))[:, 0])


class InputRecorder:
    """Records what a student is shown."""

    def __init__(self, student: Student) -> None:
        self.observations: list[Observation] = []
        (inputs,) = (part for part in student.modules() if isinstance(part, StudentInputs))
        inputs.register_forward_pre_hook(lambda _, given: self.observations.append(given[0]))


@every_student
@pytest.mark.parametrize("rows", [1, 3])
def test_a_stored_demonstration_is_seen_as_in_training(kind, rows, codebook_dir, tmp_path):
    """Replayed through the acting policy, every step of a stored episode gives the inputs of its training window."""
    rollouts = synthetic.rollouts(tmp_path / "r", 0, episodes=2, images=True)
    inputs = {"rollouts": [rollouts], "codebook": codebook_dir, "backbone": synthetic.backbone(tmp_path / "b")}
    data = loaded_data(inputs, kind, goal="own")
    request = synthetic.student_request(kind, imitation={"goal": "own"})
    sizes = {"features": 8, "proprio": synthetic.P, "actions": synthetic.A, "tasks": 1, "owns_cnn": True}
    torch.manual_seed(0)
    student = new_student(request.student, request.imitation, Sizes(**sizes))
    shown = InputRecorder(student)
    policy = policy_of(student, None, ActingConfig(), tasks=["myo/reach"], rows=rows)
    stored = Demonstrations.load(rollouts, ["image", "proprio", "final_image"])
    begin, end = int(stored.episode_ends[0]), int(stored.episode_ends[1])
    memory = policy.start(np.array([0]), stored.arrays["final_image"][1:2], [7])
    for t in range(begin, end):
        obs = {name: stored.arrays[name][t : t + 1] for name in ("image", "proprio")}
        actions, memory = policy.act(obs, memory)
        assert actions.shape == (1, synthetic.A)
    assert len(shown.observations) == end - begin
    for t, seen in zip(range(begin, end), shown.observations):
        expected = data.batch(torch.tensor([t]), generator()).observation
        if data.recurrent:  # one observation per step; the memory holds the earlier ones
            expected = replace(expected, vision=expected.vision[:, :1], proprio=expected.proprio[:, :1])
        for name in ("vision", "goal", "proprio", "task"):
            assert torch.equal(getattr(seen, name)[:1], getattr(expected, name)), (t, name)
        assert len(seen.task) == rows


@every_student
def test_images_pass_the_backbone_when_acting(kind, inputs):
    student, _ = prepared(kind, inputs)
    shown = InputRecorder(student)
    policy = policy_of(student, Pixels(), ActingConfig(), tasks=synthetic.TASKS, rows=2)
    memory = policy.start(np.array([1, 0]), np.full((2, 4, 4, 3), 9, np.uint8), [0, 1])
    for t in (1, 2):
        obs = {"image": np.full((2, 4, 4, 3), t, np.uint8), "proprio": np.full((2, synthetic.P), t, np.float32)}
        _, memory = policy.act(obs, memory)
    seen = shown.observations[1]
    assert seen.vision.unique().tolist() == [2] and seen.goal.unique().tolist() == [9] and seen.task.tolist() == [1, 0]
    # before the first step that step repeats
    assert seen.proprio[0, :, 0].tolist() == [1, 1, 2][-student.settings.history :]


@every_student
def test_a_policy_knows_its_tasks_and_whether_it_uses_a_goal(kind):
    for goal in ("off", "any"):
        request = synthetic.student_request(kind, imitation={"goal": goal})
        sizes = Sizes(features=synthetic.F, proprio=synthetic.P, actions=synthetic.A, tasks=2, owns_cnn=False)
        student = new_student(request.student, request.imitation, sizes)
        policy = policy_of(student, Pixels(), ActingConfig(), tasks=synthetic.TASKS, rows=2)
        assert policy.tasks == list(synthetic.TASKS) and policy.goal == goal
        if goal == "any":
            with pytest.raises(ValueError, match="goal: off"):
                policy.start(np.array([0]), None, [0])
        else:
            policy.start(np.array([0]), None, [0])
