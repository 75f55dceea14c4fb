"""The optimisation loop of codebook and student: schedule, clipping, validation, best weights, checkpoints."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import torch
from torch import Tensor, nn

from acgd.store import checkpoint
from acgd.store.precision import in_bfloat16
from acgd.store.stage import Context
from acgd.students.training_settings import TrainingConfig

Step = Callable[[bool], tuple[Tensor, dict[str, float]]]
"""Whether the step is logged -> loss (), and values to log."""


@dataclass
class Best:
    """The weights of the least validation score."""

    score: float = math.inf
    step: int = 0
    weights: dict[str, Tensor] = field(default_factory=dict)


def log_every(steps: int) -> int:
    """Steps between rows of metrics: a tenth of all steps, at most 100. No setting changes it: the rows are payload."""
    return max(1, min(100, steps // 10))


def learning_rate(step: int, config: TrainingConfig) -> float:
    """Learning rate of a step: linear warm-up, then constant, or half a cosine down to 1% of the peak."""
    warm = min(1.0, (step + 1) / (config.warmup + 1))
    if config.schedule == "constant":
        return config.learning_rate * warm
    done = max(0, step - config.warmup) / max(1, config.steps - config.warmup)
    return config.learning_rate * warm * (0.01 + 0.99 * 0.5 * (1 + math.cos(math.pi * done)))


def adamw(model: nn.Module, config: TrainingConfig) -> torch.optim.AdamW:
    """AdamW on all parameters with a gradient. Weight decay applies to tensors of two or more dimensions."""
    trained = [p for p in model.parameters() if p.requires_grad]
    groups = [
        {"params": [p for p in trained if p.ndim >= 2], "weight_decay": config.weight_decay},
        {"params": [p for p in trained if p.ndim < 2], "weight_decay": 0.0},
    ]
    return torch.optim.AdamW(groups, lr=config.learning_rate, fused=True)


def train(
    model: nn.Module,
    step_loss: Step,
    validate: Callable[[], dict[str, float]],
    *,
    config: TrainingConfig,
    generators: checkpoint.Generators,
    tally: dict[str, float],
    ctx: Context,
    what: str,
    chosen_by: str,
) -> Best:
    """Trains the model in place and returns the best weights. The model ends with the weights of the last step.

    validate: returns scores. The weights with the least score `chosen_by` are the best. generators: the only sources
    of randomness. tally: sums that `step_loss` accumulates. Checkpoints contain all of these, so that a resumed run
    equals an uninterrupted one bit for bit. Raises FloatingPointError of a loss that is not finite.
    """
    optimiser = adamw(model, config)
    trained = [p for group in optimiser.param_groups for p in group["params"]]
    best, start = Best(), 0
    saved = checkpoint.load(ctx.state)
    if saved is not None:
        tensors, notes = saved
        checkpoint.restore(tensors, model, optimiser, generators)
        best = Best(notes["best_score"], notes["best_step"], checkpoint.under(tensors, "best."))
        start = notes["step"]
        tally.clear()
        tally.update(notes["tally"])
    ctx.metrics.rewind(start)
    cadence = log_every(config.steps)

    with ctx.progress(config.steps, what, done=start) as bar:
        for step in range(start, config.steps):
            done = step + 1
            logged = done % cadence == 0 or done == config.steps
            rate = learning_rate(step, config)
            for group in optimiser.param_groups:
                group["lr"] = rate
            with torch.autocast(ctx.device.type, torch.bfloat16, enabled=in_bfloat16(config.precision, ctx.device)):
                loss, row = step_loss(logged)
            optimiser.zero_grad(set_to_none=True)
            loss.backward()
            norm = nn.utils.clip_grad_norm_(trained, config.clip_norm, foreach=True)
            optimiser.step()

            if logged:
                if not math.isfinite(loss.item()):
                    raise FloatingPointError(
                        f"{what}: the loss is {loss.item()} at step {done}. "
                        "Lower training.learning_rate or training.clip_norm."
                    )
                row = {**row, "loss": loss.item(), "gradient_norm": norm.item(), "learning_rate": rate}
            if done % config.validate_every == 0 or done == config.steps:
                scores = validate()
                row = {**row, **scores}
                if scores[chosen_by] < best.score:
                    best = Best(scores[chosen_by], done, {name: x.clone() for name, x in model.state_dict().items()})
            if row:
                ctx.metrics.log(done, **row)
            if done % config.checkpoint_every == 0 and done < config.steps:
                ctx.metrics.flush()
                state = checkpoint.training_state(model, optimiser, generators)
                state |= {f"best.{name}": value for name, value in best.weights.items()}
                notes = {"step": done, "best_score": best.score, "best_step": best.step, "tally": tally}
                checkpoint.save(ctx.state, state, notes)
            bar.update(1)
    return best
