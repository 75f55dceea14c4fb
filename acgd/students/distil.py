"""The stage `student`, (b) of Figure 2: L = alpha (L_lat + L_act) + gate_i L_distill, with phi_act and the codes frozen.

Divided by alpha, so that neither the clipping of gradients nor a student without guidance depends on it.
"""

import torch
from torch import Tensor

from acgd.critics.aggregate import AggregateCritic
from acgd.nn.q_ensemble import Critic
from acgd.store.checkpoint import Generators
from acgd.store.stage import Context, Inputs
from acgd.students import losses, quantizer
from acgd.students.codebook import Codebook
from acgd.students.data import Batch, Data
from acgd.students.fit_codebook import VALIDATION_BATCH, all_codes
from acgd.students.guidance import Guidance, gates, ratio_by_task, verdict
from acgd.students.settings import StudentRequest
from acgd.students.student import Student
from acgd.students.training import train

CHOSEN_BY = "validation_plan_error"
"""Chooses the best weights: the error of what the student would do. L_BC would not: L_lat, a cross-entropy, grows with confidence
while the plan still improves."""


def distil(config: StudentRequest, inputs: Inputs, ctx: Context) -> None:
    """Trains the student and writes best.safetensors, last.safetensors and student.json."""
    guided = config.student.guidance == "critic"
    codebook = Codebook.load(inputs["codebook"], ctx.device)
    data = Data.load(inputs["rollouts"], inputs.get("features"), codebook.config, states=guided, device=ctx.device)
    codes = all_codes(codebook, data)
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(config.seed)
        student = Student.of(codebook).to(ctx.device)
    guidance = load_guidance(config, inputs, ctx.device) if guided else None
    # Codes are sampled from a stream of their own: a guided and an unguided student of one seed see the same batches.
    generators = {
        name: torch.Generator(ctx.device).manual_seed(config.seed + at) for at, name in enumerate(("data", "codes"))
    }
    training, names, tally = config.student.training, [task.name for task in config.tasks], {}

    def step_loss(step: int, logged: bool) -> tuple[Tensor, dict[str, float]]:
        t = data.sample(training.batch, generators["data"])
        batch = data.batch(t, generators["data"])
        rows = round(training.batch * config.student.guided_fraction) if guided else 0
        states = data.states(t[:rows]) if guided else None
        bc, distill, row = student_losses(student, batch, codes[t], guidance, states, training.input_noise, generators)
        distill = distill / config.student.alpha if guided else None
        if not logged:
            return bc.mean() + (distill.mean() if guided else 0), {}
        row = {name: value.mean().item() for name, value in row.items()}
        if guided:
            ratios = ratio_by_task(student, bc, distill, batch.observation.task, len(names))
            row |= {f"guidance_ratio/{name}": ratio for name, ratio in zip(names, ratios)}
            for name, ratio in zip(names, ratios):
                tally[name] = tally.get(name, 0.0) + ratio
            tally["rows"] = tally.get("rows", 0) + 1
        return bc.mean() + (distill.mean() if guided else 0), row

    best = train(
        student,
        step_loss,
        lambda: validate(student, data, codes, guidance),
        training,
        generators,
        tally,
        ctx,
        "student",
        CHOSEN_BY,
    )
    notes = {
        "tasks": names,
        "student": config.student.model_dump(mode="json"),
        "seed": config.seed,
        "best": {"step": best.step, CHOSEN_BY: best.loss},
        "guidance": verdict(names, guidance, tally),
    }
    student.save(ctx.out, {"best": best.weights, "last": student.state_dict()}, notes)


def load_guidance(config: StudentRequest, inputs: Inputs, device: torch.device) -> Guidance:
    """The frozen critics of all tasks, in the study's order, and their gates."""
    critics = AggregateCritic([Critic.load(directory) for directory in inputs["critics"]], config.student.pessimism).to(
        device
    )
    weights = losses.step_weights(config.student.guided_steps, config.codebook.chunk, device)
    return Guidance(critics, gates(config.student, inputs["critics"], device), weights)


def student_losses(
    student: Student,
    batch: Batch,
    codes: Tensor,
    guidance: Guidance | None,
    states: Tensor | None,
    noise: float,
    generators: Generators,
) -> tuple[Tensor, Tensor | None, dict[str, Tensor]]:
    """L_BC (B,) and gate_i L_distill (n,), n = len(states) first rows of the batch.

    L_act decodes phi_act's code, L_distill phi_lat's straight-through sample. Both pass the decoder as one batch.
    """
    z_state, z_task = student.observer(batch.observation, noise, generators["data"])
    logits = student.latent_encoder(z_state, z_task)
    l_lat = losses.lat(logits, codes)
    z_q = student.quantizer.embed(quantizer.onehot(codes, student.config.codes))
    n = 0 if guidance is None else len(states)
    if n:
        sampled, _ = quantizer.sample(logits[:n], generators["codes"])
        z_q = torch.cat([z_q, student.quantizer.embed(sampled)])
        z_state, z_task = torch.cat([z_state, z_state[:n]]), torch.cat([z_task, z_task[:n]])
    decoded = student.decoder(z_q, z_state, z_task)
    l_act = losses.act(student.measured(decoded[: len(codes)]), student.measured(batch.chunk), batch.mask)
    row = {"l_lat": l_lat, "l_act": l_act}
    if not n:
        return l_lat + l_act, None, row
    distill = guidance.loss(states, decoded[len(codes) :], batch.chunk[:n], batch.mask[:n], batch.observation.task[:n])
    return l_lat + l_act, distill, row | {"l_distill": distill}


@torch.no_grad()
def validate(student: Student, data: Data, codes: Tensor, guidance: Guidance | None) -> dict[str, float]:
    """On the held-out episodes: L_BC; the error of what the student would do, which chooses the best weights, and its code accuracy; what the critics give it over
    the demonstration."""
    student.eval()
    generators = {"data": torch.Generator(codes.device).manual_seed(0)}
    sums: dict[str, Tensor] = {}
    for t in data.windows.validation.split(VALIDATION_BATCH):
        batch = data.batch(t, generators["data"])
        seen = batch.observation
        bc, _, row = student_losses(student, batch, codes[t], None, None, 0.0, generators)
        plan = student.plan(seen.vision, seen.goal, seen.proprio, seen.task)
        chosen = quantizer.most_likely(student.latent_encoder(*student.observer(seen)))[1]
        scores = {
            "validation_loss": bc,
            "validation_l_lat": row["l_lat"],
            "validation_l_act": row["l_act"],
            "validation_plan_error": losses.act(student.measured(plan), student.measured(batch.chunk), batch.mask)
            / plan.shape[-1],
            "validation_code_accuracy": (chosen == codes[t]).float().mean(-1),
        }
        if guidance is not None:
            gain = guidance.gain(data.states(t), plan, batch.chunk, seen.task)
            scores["validation_gain"] = -losses.distill(gain, batch.mask, guidance.weights)
        for name, value in scores.items():
            sums[name] = sums.get(name, 0) + value.sum()
    student.train()
    return {name: (total / len(data.windows.validation)).item() for name, total in sums.items()}
