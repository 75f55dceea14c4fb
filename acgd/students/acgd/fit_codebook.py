"""The stage `codebook`: L_codebook = L_act + L_code (Section III-A), and the health of the codebook."""

import json
import math

import torch
from torch import Tensor

from acgd.nn.excitation import to_loss_space
from acgd.store.stage import Context, Inputs
from acgd.students.acgd import losses, quantizer
from acgd.students.acgd.model import Codebook
from acgd.students.data import Batch, Data
from acgd.students.load import sizes_of
from acgd.students.settings import CodebookRequest
from acgd.students.training import train

VALIDATION_BATCH = 1024
"""Windows."""


def fit(request: CodebookRequest, inputs: Inputs, ctx: Context) -> None:
    """Trains the codebook and writes codebook.safetensors, codebook.json and health.json."""
    settings, training = request.student, request.student.codebook.training
    data = Data.load(
        inputs, request.imitation, chunk=settings.chunk, history=settings.history, states=False, device=ctx.device
    )
    generator = torch.Generator(ctx.device).manual_seed(request.seed)
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(request.seed)
        codebook = Codebook(settings, request.imitation, sizes_of(data, inputs)).to(ctx.device)
    codebook.observer.inputs.fit(data.windows)

    def step_loss(logged: bool) -> tuple[Tensor, dict[str, float]]:
        batch = data.batch(data.sample(training.batch, generator), generator)
        loss, terms = codebook_loss(codebook, batch, training.input_noise, generator)
        return loss, {name: term.item() for name, term in terms.items()} if logged else {}

    def validate() -> dict[str, float]:
        return {"validation_loss": reconstruction(codebook, data, data.windows.validation)["error"]}

    best = train(
        codebook,
        step_loss,
        validate,
        config=training,
        generators={"data": generator},
        tally={},
        ctx=ctx,
        what="codebook",
        chosen_by="validation_loss",
    )
    codebook.load_state_dict(best.weights)
    codebook.save(ctx.out)
    report = health(codebook, data) | {"best_step": best.step}
    (ctx.out / "health.json").write_text(json.dumps(report, indent=1, sort_keys=True) + "\n")


def codebook_loss(
    codebook: Codebook, batch: Batch, noise: float, generator: torch.Generator
) -> tuple[Tensor, dict[str, Tensor]]:
    """L_codebook = L_act + L_code (Section III-A) plus the usage bonus -> loss (), terms by name.

    The straight-through gradient passes through the decoder only.
    """
    logits = codebook.encode(batch.chunk, batch.mask)
    onehot, _ = quantizer.sample(logits, generator)
    z_state, z_task = codebook.observer(batch.observation, noise, generator)
    decoded = codebook.decode(onehot, z_state, z_task)
    space = codebook.imitation.action_space
    l_act = losses.act(to_loss_space(decoded, space), to_loss_space(batch.chunk, space), batch.mask).mean()
    l_code = losses.code(logits, onehot).mean()
    l_usage = losses.usage(logits)
    weights = codebook.settings.codebook
    loss = l_act + weights.code_weight * l_code + weights.usage_weight * l_usage
    return loss, {"l_act": l_act, "l_code": l_code, "l_usage": l_usage}


@torch.no_grad()
def reconstruction(codebook: Codebook, data: Data, steps: Tensor) -> dict[str, float]:
    """Mean absolute error per action component at `steps` (n,): with the likeliest codes, and with shuffled codes."""
    codebook.eval()
    generator = torch.Generator(steps.device).manual_seed(0)
    space = codebook.imitation.action_space
    error = shuffled = 0.0
    for t in steps.split(VALIDATION_BATCH):
        batch = data.batch(t, generator)
        onehot, _ = quantizer.most_likely(codebook.encode(batch.chunk, batch.mask))
        z_state, z_task = codebook.observer(batch.observation)
        target = to_loss_space(batch.chunk, space)
        shuffled_onehot = onehot[torch.randperm(len(t), generator=generator, device=t.device)]
        errors, shuffled_errors = (
            losses.act(to_loss_space(codebook.decode(codes, z_state, z_task), space), target, batch.mask)
            for codes in (onehot, shuffled_onehot)
        )
        error += errors.sum().item()
        shuffled += shuffled_errors.sum().item()
    codebook.train()
    per_component = len(steps) * codebook.sizes.actions
    return {"error": error / per_component, "shuffled_error": shuffled / per_component}


def health(codebook: Codebook, data: Data) -> dict:
    """Content of health.json: use of the codes, and reconstruction errors with the right and with shuffled codes.

    A decoder that ignores z_q has a shuffled_ratio of 1.
    """
    windows = data.windows
    codes = codebook.codes_of(windows)[windows.training]
    perplexity = quantizer.perplexity(codes, codebook.settings.codes).tolist()
    training, validation = (reconstruction(codebook, data, steps) for steps in (windows.training, windows.validation))
    return {
        "perplexity": perplexity,
        "codes": codebook.settings.codes,
        "bits": sum(math.log2(p) for p in perplexity),
        "reconstruction": {"training": training["error"], "validation": validation["error"]},
        "shuffled": {"training": training["shuffled_error"], "validation": validation["shuffled_error"]},
        "shuffled_ratio": validation["shuffled_error"] / validation["error"],
    }
