"""The stage `student`: minimises L_BC + gate_i L_distill / alpha for any kind of student and of guidance.

The paper's loss (Eq. 1) is alpha times this one. The division by alpha makes the clipping of gradients, and a student
without guidance, independent of alpha.

Round 0 trains on demonstrations. Round r continues from the weights of round r - 1, adds the on-policy rollouts of the
rounds 1 to r, and keeps normalisers and codebook.
"""

import torch
from safetensors.torch import load_file
from torch import Tensor

from acgd.guidance.guidance import Guidance, gradient_ratios, load_guidance, verdict
from acgd.store.checkpoint import Generators
from acgd.store.key import in_key
from acgd.store.stage import Context, Inputs
from acgd.students.data import Data
from acgd.students.errors import l1_error
from acgd.students.load import new_student, save_student, sizes_of
from acgd.students.settings import StudentRequest
from acgd.students.student import Student
from acgd.students.training import train

VALIDATION_BATCH = 1024
"""Observations."""
PLAN_ERROR = "validation_plan_error"
"""Score that selects the best weights: error of the student's plan per action component.

L_BC does not suit every kind: a cross-entropy of codes can grow with confidence while the plan still improves.
"""
ROUND_SEEDS = 1_000_000
"""Distance between the generator seeds of two rounds, greater than the usual student seeds."""


def distil(request: StudentRequest, inputs: Inputs, ctx: Context) -> None:
    """Trains the student. Writes best.safetensors, last.safetensors and student.json."""
    settings, names = request.student, [task.name for task in request.tasks]
    training = request.training
    if request.rounds is not None:
        training = training.model_copy(update={"steps": request.rounds.steps})
    guidance = load_guidance(request.guidance, inputs, chunk=settings.chunk, device=ctx.device)
    data = Data.load(
        inputs,
        request.imitation,
        chunk=settings.chunk,
        history=settings.history,
        states=guidance is not None,
        device=ctx.device,
        onpolicy_labels="expert" if request.rounds is None else request.rounds.labels,
        recurrent=settings.recurrent,
    )
    student = start(request, data, inputs, ctx.device)
    data = data.with_targets(student.prepare(data, inputs))
    generators = {
        name: torch.Generator(ctx.device).manual_seed(request.seed + index + ROUND_SEEDS * request.round)
        for index, name in enumerate(("data", "sample"))
    }
    tally: dict[str, float] = {}
    guided = 0 if guidance is None else guidance.rows(training.batch)

    def step_loss(logged: bool) -> tuple[Tensor, dict[str, float]]:
        batch = data.batch(data.sample(training.batch, generators["data"]), generators["data"])
        imitation = student.imitate(batch, guided=guided, noise=training.input_noise, generators=generators)
        l_bc = batch.weight * imitation.loss
        row, loss = dict(imitation.metrics), l_bc.mean()
        if guidance is not None:
            row["l_distill"] = guidance.loss(imitation.proposal, data.reference(batch, guided))
            l_distill = row["l_distill"] / guidance.alpha
            loss = loss + l_distill.mean()
        if not logged:
            return loss, {}
        scalars = {name: value.mean().item() for name, value in row.items()}
        if guidance is not None:
            ratios = gradient_ratios(student, l_bc, l_distill, batch.observation.task, len(names))
            scalars |= {f"guidance_ratio/{name}": ratio for name, ratio in zip(names, ratios)}
            tally["rows"] = tally.get("rows", 0) + 1
            for name, ratio in zip(names, ratios):
                tally[name] = tally.get(name, 0.0) + ratio
        return loss, scalars

    best = train(
        student,
        step_loss,
        lambda: validate(student, data, guidance),
        config=training,
        generators=generators,
        tally=tally,
        ctx=ctx,
        what="student",
        chosen_by=PLAN_ERROR,
    )
    ratios = [tally.get(name, 0.0) / max(1, tally.get("rows", 0)) for name in names]
    notes = {
        "tasks": names,
        "training": in_key(training),
        "round": request.round,
        "seed": request.seed,
        "best": {"step": best.step, PLAN_ERROR: best.score},
        "guidance": {"kind": request.guidance.kind} | verdict(names, guidance, ratios),
    }
    save_student(student, ctx.out, {"best": best.weights, "last": student.state_dict()}, notes)


def start(request: StudentRequest, data: Data, inputs: Inputs, device: torch.device) -> Student:
    """The student before its first step: initialised from the seed, or with the last weights of the previous round."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(request.seed)
        student = new_student(request.student, request.imitation, sizes_of(data, inputs)).to(device)
    if "student" in inputs:
        student.load_state_dict(load_file(inputs["student"] / "last.safetensors"))
    else:
        student.initialise(data, inputs)
    return student


@torch.no_grad()
def validate(student: Student, data: Data, guidance: Guidance | None) -> dict[str, float]:
    """Mean scores on the held-out demonstrations.

    The scores are those of the student's kind, PLAN_ERROR, and `validation_gain`, the guidance's gain of the plan over
    the demonstration.
    """
    student.eval()
    generators: Generators = {"data": torch.Generator(data.windows.task.device).manual_seed(0)}
    sums: dict[str, Tensor] = {}
    observations = data.k if data.recurrent else 1
    for t in data.windows.validation.split(max(1, VALIDATION_BATCH // observations)):
        batch = data.batch(t, generators["data"])
        plan = student.plan(batch.observation)
        error = l1_error(plan, batch, student.imitation.action_space)
        scores = student.validate(batch) | {PLAN_ERROR: error / plan.shape[-1]}
        if guidance is not None:
            scores["validation_gain"] = guidance.gain(plan, data.reference(batch))
        for name, value in scores.items():
            sums[name] = sums.get(name, 0) + value.sum()
    student.train()
    return {name: (total / len(data.windows.validation)).item() for name, total in sums.items()}
