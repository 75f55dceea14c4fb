"""The stage `codebook`: L_codebook = L_act + L_code, and the health of what came out."""

import json
import math

import torch
from torch import Tensor

from acgd.store.stage import Context, Inputs
from acgd.students import losses, quantizer
from acgd.students.codebook import Codebook, Sizes
from acgd.students.data import Batch, Data
from acgd.students.settings import CodebookRequest
from acgd.students.training import train

VALIDATION_BATCH = 1024


def fit(config: CodebookRequest, inputs: Inputs, ctx: Context) -> None:
    """Trains the codebook and writes codebook.safetensors, codebook.json and health.json."""
    data = Data.load(inputs["rollouts"], inputs.get("features"), config.codebook, states=False, device=ctx.device)
    generator = torch.Generator(ctx.device).manual_seed(config.seed)
    codebook = new_codebook(config, data, ctx.device)
    training = config.codebook.training

    def step_loss(step: int, logged: bool) -> tuple[Tensor, dict[str, float]]:
        batch = data.batch(data.sample(training.batch, generator), generator)
        return codebook_loss(codebook, batch, training.input_noise, generator, logged)

    def validate() -> dict[str, float]:
        return {"validation_loss": reconstruction(codebook, data, data.windows.validation)["error"]}

    best = train(codebook, step_loss, validate, training, {"data": generator}, {}, ctx, "codebook")
    codebook.load_state_dict(best.weights)
    codebook.save(ctx.out)
    report = health(codebook, data) | {"best_step": best.step}
    (ctx.out / "health.json").write_text(json.dumps(report, indent=1, sort_keys=True) + "\n")


def new_codebook(config: CodebookRequest, data: Data, device: torch.device) -> Codebook:
    """A codebook initialised by the seed, its inputs normalised by the training steps' statistics."""
    windows = data.windows
    scratch = config.backbone.kind == "scratch"
    features = config.backbone.dim if scratch else windows.steps["vision"].shape[-1]
    sizes = Sizes(
        features, windows.steps["proprio"].shape[-1], windows.steps["label"].shape[-1], len(config.tasks), scratch
    )
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(config.seed)
        codebook = Codebook(config.codebook, sizes).to(device)
    codebook.observer.normalise_proprio.fit(windows.steps["proprio"][windows.training])
    if not scratch:
        codebook.observer.normalise_features.fit(windows.steps["vision"][windows.training])
    return codebook


def codebook_loss(
    codebook: Codebook, batch: Batch, noise: float, generator: torch.Generator, logged: bool = True
) -> tuple[Tensor, dict[str, float]]:
    """L_codebook = L_act + L_code (Section III-A), and the usage bonus. The straight-through gradient enters the decoder alone."""
    logits = codebook.encode(batch.chunk, batch.mask)
    onehot, _ = quantizer.sample(logits, generator)
    z_state, z_task = codebook.observer(batch.observation, noise, generator)
    decoded = codebook.decoder(codebook.quantizer.embed(onehot), z_state, z_task)
    l_act = losses.act(codebook.measured(decoded), codebook.measured(batch.chunk), batch.mask).mean()
    l_code = losses.code(logits, onehot).mean()
    l_usage = losses.usage(logits)
    loss = l_act + codebook.config.code_weight * l_code + codebook.config.usage_weight * l_usage
    return loss, {"l_act": l_act.item(), "l_code": l_code.item(), "l_usage": l_usage.item()} if logged else {}


@torch.no_grad()
def reconstruction(codebook: Codebook, data: Data, steps: Tensor) -> dict[str, float]:
    """Mean absolute error per action component, with the likeliest codes and with those of another row."""
    codebook.eval()
    generator = torch.Generator(steps.device).manual_seed(0)
    error = shuffled = 0.0
    for t in steps.split(VALIDATION_BATCH):
        batch = data.batch(t, generator)
        onehot, _ = quantizer.most_likely(codebook.encode(batch.chunk, batch.mask))
        z = codebook.observer(batch.observation)
        target = codebook.measured(batch.chunk)
        other = onehot[torch.randperm(len(t), generator=generator, device=t.device)]
        error += (
            losses.act(codebook.measured(codebook.decoder(codebook.quantizer.embed(onehot), *z)), target, batch.mask)
            .sum()
            .item()
        )
        shuffled += (
            losses.act(codebook.measured(codebook.decoder(codebook.quantizer.embed(other), *z)), target, batch.mask)
            .sum()
            .item()
        )
    codebook.train()
    per_component = len(steps) * codebook.sizes.actions
    return {"error": error / per_component, "shuffled_error": shuffled / per_component}


def health(codebook: Codebook, data: Data) -> dict:
    """Is the codebook used, and by the decoder? A shuffled error like the plain one means that the decoder ignores z_q."""
    windows = data.windows
    codes = all_codes(codebook, data)[windows.training]
    perplexity = quantizer.perplexity(codes, codebook.config.codes).tolist()
    training, validation = (reconstruction(codebook, data, steps) for steps in (windows.training, windows.validation))
    return {
        "perplexity": perplexity,
        "codes": codebook.config.codes,
        "bits": sum(math.log2(p) for p in perplexity),
        "reconstruction": {"training": training["error"], "validation": validation["error"]},
        "shuffled": {"training": training["shuffled_error"], "validation": validation["shuffled_error"]},
        "shuffled_ratio": validation["shuffled_error"] / validation["error"],
    }


@torch.no_grad()
def all_codes(codebook: Codebook, data: Data) -> Tensor:
    """phi_act's likeliest codes of the window at every step, (N, G), computed once."""
    windows = data.windows
    every = torch.arange(len(windows.task), device=windows.task.device)
    return torch.cat([codebook.codes(*windows.chunk_of("label", t, data.k)) for t in every.split(VALIDATION_BATCH)])
