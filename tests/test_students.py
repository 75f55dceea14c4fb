"""Contracts of the codebook, the student, critic guidance and acting."""

import json
from dataclasses import fields
from inspect import signature
from pathlib import Path

import numpy as np
import pytest
import synthetic
import torch
from safetensors.torch import load_file
from torch import Tensor

from acgd import students
from acgd.critics.aggregate import AggregateCritic
from acgd.nn.excitation import stretched_excitation
from acgd.nn.q_ensemble import Critic
from acgd.store import metrics
from acgd.store.stage import Context
from acgd.students import fit_codebook, losses, quantizer
from acgd.students.acting import Actor
from acgd.students.codebook import Codebook, Sizes
from acgd.students.data import Data
from acgd.students.decoder import Decoder
from acgd.students.distil import distil, student_losses, validate
from acgd.students.ensembling import ensemble
from acgd.students.guidance import Guidance, gates, ratio_by_task
from acgd.students.observer import Normaliser, Observation
from acgd.students.quantizer import Quantizer
from acgd.students.settings import ActingConfig, CodebookConfig, StudentConfig, TrainingConfig
from acgd.students.student import Student
from acgd.students.training import learning_rate

STATES = (9, 12)


def generator(seed: int = 0) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


@pytest.fixture(scope="module")
def rollouts(tmp_path_factory) -> list[Path]:
    root = tmp_path_factory.mktemp("rollouts")
    return [synthetic.rollouts(root / str(i), i, state=STATES[i]) for i in range(2)]


@pytest.fixture(scope="module")
def critics(tmp_path_factory) -> list[Path]:
    root = tmp_path_factory.mktemp("critics")
    return [synthetic.critic(root / str(i), STATES[i], low=low, seed=i) for i, low in enumerate((0.4, 0.1))]


@pytest.fixture(scope="module")
def codebook_dir(rollouts, tmp_path_factory) -> Path:
    ctx = synthetic.context(tmp_path_factory.mktemp("codebook"))
    fit_codebook.fit(synthetic.codebook_request(), {"rollouts": rollouts, "features": rollouts}, ctx)
    return ctx.out


@pytest.fixture
def data(rollouts) -> Data:
    return Data.load(rollouts, rollouts, synthetic.codebook_request().codebook, states=True, device=torch.device("cpu"))


@pytest.fixture
def student(codebook_dir) -> Student:
    torch.manual_seed(0)
    return Student.of(Codebook.load(codebook_dir, torch.device("cpu")))


@pytest.fixture
def guidance(critics) -> Guidance:
    return Guidance(AggregateCritic([Critic.load(c) for c in critics], 1.0), torch.ones(2), torch.ones(4))


def run(stage, request, inputs, directory: Path) -> Path:
    ctx = synthetic.context(directory)
    stage(request, inputs, ctx)
    ctx.metrics.flush()
    return ctx.out


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
    assert losses.distill(q, mask, losses.step_weights("chunk", 3, q.device)).tolist() == [-2.0]
    assert losses.distill(q, mask, losses.step_weights("first", 3, q.device)).tolist() == [-1.0]


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
    book = Quantizer(groups=3, codes=4, width=5)
    codes = torch.tensor([[0, 2, 3]])
    assert torch.allclose(
        book.embed(quantizer.onehot(codes, 4))[0], book.codes[0, 0] + book.codes[1, 2] + book.codes[2, 3]
    )


def test_distances_as_logits_choose_the_nearest_code():
    book = Quantizer(groups=2, codes=6, width=3, distance=True)
    z_e = torch.randn(7, 2, 3, generator=generator())
    distance = (z_e[:, :, None] - book.codes).square().sum(-1)
    assert torch.allclose(book.logits(z_e), -distance, atol=1e-5)
    assert book.encoding_size == 3


def test_perplexity_counts_codes_in_use():
    codes = torch.tensor([[0, 5], [1, 5], [2, 5], [3, 5]])
    assert quantizer.perplexity(codes, 8).tolist() == pytest.approx([4.0, 1.0])


# --- data -----------------------------------------------------------------------------------------------------


def test_windows_align_chunk_history_and_states_by_step(data):
    """In the synthetic demonstrations proprio[0] is t / 10 and the action a known function of t: an off-by-one shows."""
    t = data.windows.training[[0, 3, 17]]
    batch = data.batch(t, generator())
    step = (t - data.windows.start[t]).float()
    expected = torch.stack([(step - j).clamp(min=0) for j in (2, 1, 0)], 1) / 10
    assert torch.allclose(batch.observation.proprio[:, :, 0], expected)
    for j in range(data.k):
        inside = step + j < (data.windows.end - data.windows.start)[t]
        assert batch.mask[:, j].tolist() == inside.tolist()
        at = torch.minimum(t + j, data.windows.end[t] - 1)
        assert torch.equal(batch.chunk[:, j], data.windows.steps["label"][at])
        assert torch.equal(data.states(t)[:, j], data.windows.steps["state"][at])


def test_batches_are_balanced_and_hold_training_episodes_and_goals_of_the_own_task(data):
    t = data.sample(31, generator())
    task = data.windows.task[t]
    assert (task.bincount() - 15.5).abs().max() <= 0.5 and task[:6].tolist() == [0, 1] * 3
    assert torch.isin(t, data.windows.training).all() and not torch.isin(t, data.windows.validation).any()
    goal = data.batch(t, generator()).observation.goal
    for row, own in zip(goal, task):
        (episode,) = (data.windows.episodes["goal"] == row).all(-1).nonzero().flatten().tolist()
        assert data.windows.episode_task[episode] == own and episode in data.goals[own]


def test_goal_image_own_and_off(rollouts):
    for kind in ("own", "off"):
        config = synthetic.codebook_request(goal_image=kind).codebook
        data = Data.load(rollouts, rollouts, config, states=False, device=torch.device("cpu"))
        t = data.sample(8, generator())
        goal = data.batch(t, generator()).observation.goal
        assert (
            goal is None if kind == "off" else torch.equal(goal, data.windows.episodes["goal"][data.windows.episode[t]])
        )


def test_labels_are_the_mean_or_the_executed_action(rollouts):
    for label, name in (("mean", "mean_action"), ("executed", "action")):
        config = synthetic.codebook_request(label=label).codebook
        data = Data.load(rollouts[:1], rollouts[:1], config, states=False, device=torch.device("cpu"))
        stored = students_arrays(rollouts[0], name)
        assert np.array_equal(data.windows.steps["label"].numpy(), stored)


def students_arrays(directory: Path, name: str) -> np.ndarray:
    from acgd.rollouts.dataset import Demonstrations

    return Demonstrations.load(directory, [name]).arrays[name]


def test_normaliser_does_not_blow_up_what_never_moved():
    x = torch.randn(100, 3, generator=generator())
    x[:, 2] = 1 + 1e-9 * torch.randn(100, generator=generator())
    normaliser = Normaliser(3)
    normaliser.fit(x)
    assert normaliser(x)[:, :2].std(0).tolist() == pytest.approx([1, 1], abs=0.05)
    assert normaliser(x + 0.01).abs().max() <= 5 and normaliser(x)[:, 2].abs().max() < 0.1


# --- what flows where -----------------------------------------------------------------------------------------


def losses_of(student: Student, data: Data, guidance: Guidance | None, states: Tensor | None, n: int = 16):
    t = data.sample(n, generator())
    codes = torch.randint(0, student.config.codes, (n, student.config.groups), generator=generator())
    streams = {"data": generator(1), "codes": generator(2)}
    return student_losses(student, data.batch(t, generator(3)), codes, guidance, states, 0.0, streams)


def test_gradient_of_q_reaches_the_latent_encoder_through_the_sample_and_leaves_the_critic(student, data, guidance):
    states = data.states(data.sample(16, generator()))
    before = {name: value.clone() for name, value in guidance.critic.state_dict().items()}
    _, distill, _ = losses_of(student, data, guidance, states)
    distill.mean().backward()
    for part in (student.latent_encoder, student.decoder, student.observer):
        assert sum(p.grad.abs().sum() for p in part.parameters() if p.grad is not None) > 0
    assert student.latent_encoder.net[-1].weight.grad.abs().max() > 0
    assert student.quantizer.codes.grad is None
    assert not any(p.grad is not None for p in guidance.critic.parameters())
    assert all(torch.equal(value, before[name]) for name, value in guidance.critic.state_dict().items())


def test_distill_is_the_critics_own_judgement_of_the_decoded_sample(student, data, critics):
    """Step j of the chunk with the state of step j, each row by its own task's critic, in spreads."""
    t = data.sample(6, generator())
    batch, states = data.batch(t, generator()), data.states(t)
    chunk = torch.rand(6, 4, synthetic.A, generator=generator()) * 2 - 1
    members = [Critic.load(c) for c in critics]
    guidance = Guidance(AggregateCritic(members, 0.0), torch.tensor([1.0, 0.5]), torch.ones(4))
    expected = []
    for row in range(6):
        task = int(batch.observation.task[row])
        own = members[task]
        q, shown = (
            [own(states[row, j : j + 1, : STATES[task]], of[row, j : j + 1]).mean().item() for j in range(4)]
            for of in (chunk, batch.chunk)
        )
        valid = [(x - y) / own.spread.item() for x, y, inside in zip(q, shown, batch.mask[row]) if inside]
        expected.append(-(1.0, 0.5)[task] * sum(valid) / len(valid))
    assert guidance.loss(states, chunk, batch.chunk, batch.mask, batch.observation.task).tolist() == pytest.approx(
        expected, rel=1e-4
    )


def test_the_student_cannot_read_the_privileged_state(student, data, guidance):
    """Other states: the same actions, the same gradient of L_BC; and there is no way in for them."""
    assert not {"state", "states"} & (set(signature(Student.plan).parameters) | {f.name for f in fields(Observation)})
    assert not {"state", "states"} & (set(signature(Actor.act).parameters) | set(signature(Actor.reset).parameters))
    t = data.sample(16, generator())
    found = []
    for scale in (1.0, -100.0):
        student.zero_grad()
        bc, distill, _ = losses_of(student, data, guidance, data.states(t) * scale)
        bc.mean().backward()
        seen = data.batch(t, generator(3)).observation
        plan = student.plan(seen.vision, seen.goal, seen.proprio, seen.task)
        found.append((plan, [p.grad.clone() for p in student.parameters() if p.grad is not None], distill.detach()))
    assert torch.equal(found[0][0], found[1][0])
    assert all(torch.equal(a, b) for a, b in zip(found[0][1], found[1][1]))
    assert not torch.equal(found[0][2], found[1][2])  # the critic, though, did read them


def test_masked_steps_reach_no_loss(student, data, guidance):
    t = data.windows.end[data.windows.training][:8] - 1  # the last step of an episode: one valid step
    batch, states = data.batch(t, generator()), data.states(t)
    codes = torch.zeros(8, 2, dtype=torch.long)

    def all_losses(chunk: Tensor, states: Tensor) -> list[Tensor]:
        changed = type(batch)(batch.t, batch.observation, chunk, batch.mask)
        bc, distill, _ = student_losses(
            student, changed, codes, guidance, states, 0.0, {"data": generator(), "codes": generator()}
        )
        return [bc, distill]

    chunk, other = batch.chunk.clone(), states.clone()
    chunk[:, 1:], other[:, 1:] = 0.77, 50.0
    assert batch.mask.sum() == 8
    for before, after in zip(all_losses(batch.chunk, states), all_losses(chunk, other)):
        assert torch.allclose(before, after)


def test_codes_of_a_chunk_do_not_depend_on_what_lies_past_the_end(codebook_dir):
    codebook = Codebook.load(codebook_dir, torch.device("cpu"))
    chunk, mask = torch.zeros(1, 4, synthetic.A), torch.tensor([[True, True, False, False]])
    other = chunk.clone()
    other[:, 2:] = 1
    assert torch.equal(codebook.encode(chunk, mask), codebook.encode(other, mask))


def test_actions_stay_strictly_inside_the_box_with_a_gradient():
    torch.manual_seed(0)
    decoder = Decoder(4, 5, 16, 2, 1, 2)
    z = torch.randn(3, 16, requires_grad=True)
    chunk = decoder(z, z, z)
    assert chunk.shape == (3, 4, 5) and chunk.abs().max() < 1
    with torch.no_grad():
        decoder.head.bias.fill_(3.0)
    chunk = decoder(z, z, z)
    chunk.sum().backward()
    assert chunk.abs().max() < 1 and z.grad.abs().max() > 0


# --- gates and the weight of guidance -------------------------------------------------------------------------


def test_gate_reliable_closes_where_the_interval_reaches_below(critics):
    assert gates(StudentConfig(gate="one"), critics, torch.device("cpu")).tolist() == [1, 1]
    assert gates(StudentConfig(gate="reliable"), critics, torch.device("cpu")).tolist() == [1, 0]


def test_gradient_ratio_is_per_task(student, data, guidance):
    t = data.sample(16, generator())
    bc, _, _ = losses_of(student, data, None, None)
    task = data.windows.task[t]
    distill = bc * torch.where(task == 0, 0.5, 0.0)
    assert ratio_by_task(student, bc, distill, task, 2) == pytest.approx([0.5, 0.0], abs=1e-5)


# --- the stages -----------------------------------------------------------------------------------------------


def test_codebook_artifact_and_health(codebook_dir):
    assert sorted(p.name for p in codebook_dir.iterdir()) >= ["codebook.json", "codebook.safetensors", "health.json"]
    health = json.loads((codebook_dir / "health.json").read_text())
    assert len(health["perplexity"]) == 2 and all(1 <= p <= 8 for p in health["perplexity"])
    assert health["reconstruction"]["validation"] > 0 and health["shuffled"]["validation"] > 0


def test_student_learns_a_small_dataset(rollouts, critics, tmp_path):
    """Codebook and guided student on two tasks: reconstruction, planning and Q all improve; codes carry the chunk."""
    training = {
        "steps": 250,
        "batch": 64,
        "validate_every": 50,
        "log_every": 50,
        "checkpoint_every": 1000,
        "learning_rate": 3e-3,
        "input_noise": 0.0,
    }
    request = synthetic.codebook_request(training=training)
    book = run(fit_codebook.fit, request, {"rollouts": rollouts, "features": rollouts}, tmp_path / "codebook")
    health = json.loads((book / "health.json").read_text())
    assert health["reconstruction"]["training"] < 0.1 and health["shuffled_ratio"] > 2

    inputs = {"rollouts": rollouts, "features": rollouts, "codebook": book, "critics": critics}
    out = run(distil, synthetic.student_request(request, training, gate="reliable"), inputs, tmp_path / "student")
    card = json.loads((out / "student.json").read_text())
    assert card["guidance"]["myo/reach"]["gate"] == 1 and card["guidance"]["myo/reach"]["counts_as_guidance"]
    assert card["guidance"]["myo/obj-hold"] == {"gate": 0, "gradient_ratio": 0, "counts_as_guidance": False}
    rows = metrics.read(out / "metrics.jsonl")
    assert {
        "l_lat",
        "l_act",
        "l_distill",
        "guidance_ratio/myo/reach",
        "validation_gain",
        "validation_plan_error",
    } <= rows[-1].keys()
    assert rows[-1]["l_act"] < rows[0]["l_act"]

    data = Data.load(rollouts, rollouts, request.codebook, states=False, device=torch.device("cpu"))
    learned = students.load(out, "last")
    seen = data.batch(data.windows.training, generator()).observation
    chunk, mask = data.windows.chunk_of("label", data.windows.training, data.k)
    error = losses.act(learned.plan(seen.vision, seen.goal, seen.proprio, seen.task), chunk, mask).mean() / synthetic.A
    assert error < 0.2 < chunk.abs().mean()  # predicting nothing would err by the labels' mean size


def test_unguided_student_needs_no_critic_and_sees_the_same_batches(rollouts, critics, codebook_dir, tmp_path):
    inputs = {"rollouts": rollouts, "features": rollouts, "codebook": codebook_dir}
    request = synthetic.codebook_request()
    training = {"steps": 1, "log_every": 1}
    alone = run(distil, synthetic.student_request(request, training, guidance="none"), inputs, tmp_path / "a")
    led = run(distil, synthetic.student_request(request, training), inputs | {"critics": critics}, tmp_path / "b")
    first = [metrics.read(out / "metrics.jsonl")[0] for out in (alone, led)]
    assert first[0]["l_act"] == pytest.approx(first[1]["l_act"], rel=1e-5) and first[0]["l_lat"] == first[1]["l_lat"]
    assert json.loads((alone / "student.json").read_text())["guidance"] == {}


def test_alpha_is_nothing_to_a_student_without_guidance(rollouts, codebook_dir, tmp_path):
    inputs = {"rollouts": rollouts, "features": rollouts, "codebook": codebook_dir}
    training = {"steps": 3, "clip_norm": 0.1}  # every gradient is clipped
    request = synthetic.codebook_request()
    out = [
        run(
            distil,
            synthetic.student_request(request, training, guidance="none", alpha=alpha),
            inputs,
            tmp_path / str(alpha),
        )
        for alpha in (1.0, 30.0)
    ]
    assert (out[0] / "last.safetensors").read_bytes() == (out[1] / "last.safetensors").read_bytes()


class Killed(Exception):
    pass


class KillingMetrics(metrics.Metrics):
    """Dies at a step, its rows on the disk or not as the flushes would have it."""

    at = 5

    def log(self, step: int, **values: float) -> None:
        super().log(step, **values)
        if step >= self.at:
            raise Killed


@pytest.mark.parametrize("stage", ["codebook", "student"])
def test_a_resumed_run_equals_an_uninterrupted_one_bit_for_bit(stage, rollouts, critics, codebook_dir, tmp_path):
    training = {"steps": 6, "log_every": 1, "validate_every": 2, "checkpoint_every": 3}
    request = synthetic.codebook_request(training=training)
    inputs = {"rollouts": rollouts, "features": rollouts}
    verb = fit_codebook.fit
    if stage == "student":
        request, verb = synthetic.student_request(request, training), distil
        inputs |= {"codebook": codebook_dir, "critics": critics}
    whole = run(verb, request, inputs, tmp_path / "whole")

    ctx = synthetic.context(tmp_path / "cut")
    with pytest.raises(Killed):
        verb(
            request,
            inputs,
            Context(ctx.out, ctx.state, KillingMetrics(ctx.out / "metrics.jsonl"), ctx.progress, ctx.device),
        )
    assert (ctx.state / "checkpoint.safetensors").exists()
    resumed = run(verb, request, inputs, tmp_path / "cut")
    names = sorted(p.name for p in whole.iterdir())
    assert sorted(p.name for p in resumed.iterdir()) == names and len(names) >= 4
    for name in names:
        assert (whole / name).read_bytes() == (resumed / name).read_bytes(), name


def test_seed_changes_initialisation_data_and_codes(rollouts, codebook_dir, tmp_path):
    inputs = {"rollouts": rollouts, "features": rollouts}
    books = [
        run(fit_codebook.fit, synthetic.codebook_request(seed), inputs, tmp_path / f"{i}")
        for i, seed in enumerate((0, 1))
    ]
    same, other = (load_file(b / "codebook.safetensors")["quantizer.codes"] for b in books)
    assert torch.equal(same, load_file(codebook_dir / "codebook.safetensors")["quantizer.codes"]) and not torch.equal(
        same, other
    )


def test_last_weights_and_best_weights_are_both_kept(rollouts, codebook_dir, tmp_path):
    training = {
        "steps": 4,
        "validate_every": 2,
        "learning_rate": 1.0,
        "clip_norm": 1e9,
        "warmup": 0,
    }  # diverges, so that best is not last
    request = synthetic.codebook_request()
    inputs = {"rollouts": rollouts, "features": rollouts, "codebook": codebook_dir}
    out = run(distil, synthetic.student_request(request, training, guidance="none"), inputs, tmp_path)
    best, last = (load_file(out / f"{name}.safetensors") for name in ("best", "last"))
    step = json.loads((out / "student.json").read_text())["best"]["step"]
    equal = all(torch.equal(best[name], last[name]) for name in best)
    assert equal == (step == 4)
    assert torch.equal(
        best["quantizer.codes"], load_file(codebook_dir / "codebook.safetensors")["quantizer.codes"]
    )  # frozen


@pytest.mark.parametrize(
    "codebook",
    [
        {"logits": "distance"},
        {"action_space": "excitation"},
        {"goal_image": "off"},
        {"training": {"precision": "bfloat16"}},
    ],
)
def test_options_train_save_and_load(codebook, rollouts, critics, tmp_path):
    training = codebook.get("training", {})
    request = synthetic.codebook_request(**codebook)
    inputs = {"rollouts": rollouts, "features": rollouts, "critics": critics}
    inputs["codebook"] = run(fit_codebook.fit, request, inputs, tmp_path / "codebook")
    out = run(distil, synthetic.student_request(request, training, guided_steps="first"), inputs, tmp_path / "student")
    goal = None if request.codebook.goal_image == "off" else torch.zeros(3, synthetic.F)
    chunk = students.load(out).plan(
        torch.zeros(3, synthetic.F), goal, torch.zeros(3, 3, synthetic.P), torch.tensor([0, 1, 0])
    )
    assert chunk.shape == (3, 4, synthetic.A) and chunk.abs().max() < 1 and torch.isfinite(chunk).all()


def test_scratch_owns_its_cnn_and_reads_images(critics, tmp_path):
    rollouts = [synthetic.rollouts(tmp_path / f"r{i}", i, episodes=3, state=STATES[i], images=True) for i in range(2)]
    request = synthetic.codebook_request(backbone="scratch", training={"steps": 2, "batch": 4})
    inputs = {"rollouts": rollouts, "critics": critics}
    inputs["codebook"] = run(fit_codebook.fit, request, inputs, tmp_path / "codebook")
    out = run(distil, synthetic.student_request(request, {"steps": 2, "batch": 4}), inputs, tmp_path / "student")
    before, after = (
        load_file(f)["observer.cnn.mix.0.weight"]
        for f in (inputs["codebook"] / "codebook.safetensors", out / "last.safetensors")
    )
    assert not torch.equal(before, after)
    actor = Actor(students.load(out), None, ActingConfig())
    images = np.zeros((2, 32, 32, 3), np.uint8)
    actions, _ = actor.act({"image": images, "proprio": np.zeros((2, synthetic.P))}, actor.reset([0, 1], images))
    assert actions.shape == (2, synthetic.A)


def test_validation_leaves_training_untouched(student, data):
    state = torch.random.get_rng_state()
    codes = torch.zeros(len(data.windows.task), 2, dtype=torch.long)
    first, second = (validate(student, data, codes, None) for _ in range(2))
    assert first == second and student.training and torch.equal(state, torch.random.get_rng_state())


def test_schedule_warms_up_and_falls():
    config = TrainingConfig(steps=100, warmup=9, learning_rate=1.0)
    assert learning_rate(0, config) == pytest.approx(0.1)
    assert learning_rate(9, config) == pytest.approx(1.0)
    assert learning_rate(99, config) < 0.02
    assert learning_rate(99, config.model_copy(update={"schedule": "constant"})) == 1.0


def test_heads_that_do_not_divide_the_width_are_refused():
    with pytest.raises(ValueError, match="width 130 is no multiple of heads 4"):
        CodebookConfig(width=130)


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


class Scripted:
    """A student whose chunk, planned at step t, says 100 t + (t + j) for each of its steps j: who said what is visible."""

    config = CodebookConfig(chunk=3, history=2, goal_image="off")
    sizes = Sizes(features=4, proprio=1, actions=1, tasks=2, owns_cnn=True)

    def eval(self):
        return self

    def parameters(self):
        return iter([torch.zeros(1)])

    def plan(self, features, goal, proprio, task):
        t = proprio[:, -1]
        return (100 * t + t + torch.arange(3))[..., None].float()


def roll(mode: str, steps: int, offsets: tuple[int, ...] = (0,)) -> np.ndarray:
    actor = Actor(Scripted(), None, ActingConfig(mode=mode, eta=0.3))
    memory = actor.reset([0] * len(offsets), None)
    taken = []
    for t in range(steps):
        proprio = np.array([[t + offset] for offset in offsets], np.float32)
        action, memory = actor.act({"image": np.zeros((len(offsets), 2, 2, 3), np.uint8), "proprio": proprio}, memory)
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


def test_actor_feeds_history_goal_and_task_as_in_training(codebook_dir, student):
    seen = []
    student.plan = lambda *inputs: seen.append(inputs) or torch.zeros(2, 4, synthetic.A)
    actor = Actor(student, lambda images: images.float().mean((1, 2))[:, :1].expand(-1, synthetic.F), ActingConfig())
    memory = actor.reset([1, 0], np.full((2, 4, 4, 3), 9, np.uint8))
    for t in (1, 2):
        obs = {"image": np.full((2, 4, 4, 3), t, np.uint8), "proprio": np.full((2, synthetic.P), t, np.float32)}
        _, memory = actor.act(obs, memory)
    features, goal, proprio, task = seen[1]
    assert features.unique().tolist() == [2] and goal.unique().tolist() == [9] and task.tolist() == [1, 0]
    assert proprio[0, :, 0].tolist() == [1, 1, 2]  # before the first step that step repeats


def test_missing_goal_or_backbone_is_refused_with_the_mend(student):
    with pytest.raises(ValueError, match="backbone"):
        Actor(student, None, ActingConfig())
    with pytest.raises(ValueError, match="goal_image: off"):
        Actor(student, torch.nn.Identity(), ActingConfig()).reset([0], None)
