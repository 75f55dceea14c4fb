"""Cost of a training step of a student in one thread, against matrix products: `python -m benchmarks.student`."""

import statistics
import time
from collections.abc import Callable

import torch
from torch.utils.flop_counter import FlopCounterMode

from acgd.critics.aggregate import AggregateCritic
from acgd.guidance.critic.guidance import CriticGuidance, step_weights
from acgd.guidance.critic.settings import CriticGuidanceConfig
from acgd.nn.q_ensemble import Critic
from acgd.rollouts.windows import Windows
from acgd.settings import Section, imported
from acgd.store.precision import in_bfloat16
from acgd.students.acgd.settings import ACGDConfig
from acgd.students.data import Data
from acgd.students.kinds import STUDENTS
from acgd.students.load import new_student
from acgd.students.settings import ImitationConfig
from acgd.students.student import Sizes
from acgd.students.training import adamw
from acgd.students.training_settings import TrainingConfig
from benchmarks.row import Row

TASKS, EPISODES, LENGTH = 3, 30, 100
FEATURES, PROPRIO, STATE, ACTIONS = 64, 85, 110, 39
STEPS, WARMUP = 30, 3
WIDTH = 128
"""Of every kind of student where kinds are compared."""
GEMM = 1024
MOST_GUIDANCE = 1.40


def run() -> list[Row]:
    """Rows of a matrix product; of an unguided and a guided step of acgd (two dueling critics of 128 units per task);
    of an unguided step of every kind of student at the same width and batch.

    The calls take turns. Times are processor times, which other processes disturb less. The median counts.
    """
    torch.set_num_threads(1)
    torch.manual_seed(0)
    a, b = torch.randn(GEMM, GEMM), torch.randn(GEMM, GEMM)
    unguided, guided = (training_step(ACGDConfig(), with_critic) for with_critic in (False, True))
    of_kind = {kind: training_step(imported(STUDENTS[kind].settings)(width=WIDTH), False) for kind in STUDENTS}
    gemm_s, imitation_s, guided_s, *kinds_s = in_turn(lambda: a @ b, unguided, guided, *of_kind.values())
    batch, gemm_rate = TrainingConfig().batch, 2 * GEMM**3 / gemm_s

    def row_of(name: str, step: Callable[[], None], seconds: float) -> Row:
        share = flops(step) / seconds / gemm_rate
        target = "ratio: share of the GEMM rate reached"
        return Row(
            name=f"student/{name}", value=batch / seconds, unit="samples/s", ratio=share, target=target, met=None
        )

    return [
        row_of("imitation", unguided, imitation_s),
        Row(name="student/gemm", value=gemm_rate / 1e9, unit="GFLOP/s", ratio=None, target="", met=None),
        Row(
            name="student/guidance",
            value=batch / guided_s,
            unit="samples/s",
            ratio=guided_s / imitation_s,
            target=f"ratio: <= {MOST_GUIDANCE:.2f} times the cost of imitation alone",
            met=guided_s / imitation_s <= MOST_GUIDANCE,
        ),
        *(row_of(f"of kind {kind}", step, seconds) for (kind, step), seconds in zip(of_kind.items(), kinds_s)),
    ]


def flops(step: Callable[[], None]) -> int:
    """Floating-point operations of the matrix products of one step."""
    with FlopCounterMode(display=False) as counter:
        step()
    return counter.get_total_flops()


def training_step(settings: Section, guided: bool) -> Callable[[], None]:
    """A function that executes one optimiser step of a student, as `distil` does, at the size of the default study."""
    imitation, training, by_critic = ImitationConfig(), TrainingConfig(), CriticGuidanceConfig()
    data = Data.of(_windows(), imitation, settings.chunk, settings.history, recurrent=settings.recurrent)
    if "codebook" in settings.needs:
        codes = torch.randint(settings.codes, (len(data.windows.task), settings.groups))
        data = data.with_targets({"codes": codes})
    student = new_student(settings, imitation, Sizes(FEATURES, PROPRIO, ACTIONS, TASKS, owns_cnn=False))
    critics = [Critic(STATE, ACTIONS, members=2, width=128, dueling=True) for _ in range(TASKS)]
    guidance = CriticGuidance(
        critic=AggregateCritic(critics, by_critic.pessimism),
        gates=torch.ones(TASKS),
        weights=step_weights(by_critic.guided_steps, settings.chunk, torch.device("cpu")),
        alpha=by_critic.alpha,
        fraction=by_critic.guided_fraction,
    )
    optimiser = adamw(student, training)
    trained = [p for group in optimiser.param_groups for p in group["params"]]
    generators = {name: torch.Generator().manual_seed(0) for name in ("data", "sample")}
    rows = guidance.rows(training.batch) if guided else 0
    bfloat16 = in_bfloat16(training.precision, torch.device("cpu"))

    def step() -> None:
        batch = data.batch(data.sample(training.batch, generators["data"]), generators["data"])
        with torch.autocast("cpu", torch.bfloat16, enabled=bfloat16):
            imitated = student.imitate(batch, guided=rows, noise=training.input_noise, generators=generators)
            loss = (batch.weight * imitated.loss).mean()
            if guided:
                loss = loss + (guidance.loss(imitated.proposal, data.reference(batch, rows)) / guidance.alpha).mean()
        optimiser.zero_grad(set_to_none=True)
        loss.backward()
        torch.nn.utils.clip_grad_norm_(trained, training.clip_norm, foreach=True)
        optimiser.step()

    return step


def in_turn(*calls: Callable[[], object]) -> list[float]:
    """Median processor seconds of each call. The calls take turns, so that other processes slow all of them."""
    seconds: list[list[float]] = [[] for _ in calls]
    for repeat in range(WARMUP + STEPS):
        for times, call in zip(seconds, calls):
            start = time.process_time()
            call()
            if repeat >= WARMUP:
                times.append(time.process_time() - start)
    return [statistics.median(times) for times in seconds]


def _windows() -> Windows:
    """Random demonstrations of the size of the default study."""
    steps, episodes = TASKS * EPISODES * LENGTH, TASKS * EPISODES
    index = torch.arange(steps)
    return Windows(
        steps={
            "vision": torch.randn(steps, FEATURES),
            "proprio": torch.randn(steps, PROPRIO),
            "label": torch.rand(steps, ACTIONS) * 2 - 1,
            "weight": torch.ones(steps),
            "state": torch.randn(steps, STATE),
        },
        episodes={"goal": torch.randn(episodes, FEATURES)},
        task=index // (EPISODES * LENGTH),
        episode=index // LENGTH,
        start=index // LENGTH * LENGTH,
        end=index // LENGTH * LENGTH + LENGTH,
        episode_task=torch.arange(episodes) // EPISODES,
        training=index,
        validation=index[:0],
    )


if __name__ == "__main__":
    for row in run():
        print(row)
