"""What a step of student training costs, in one thread, beside the machine's matrix products: `python -m benchmarks.student`."""

import statistics
import time
from collections.abc import Callable

import torch
from acgd.students.codebook import Codebook, Sizes
from acgd.students.guidance import Guidance
from torch.utils.flop_counter import FlopCounterMode

from acgd.critics.aggregate import AggregateCritic
from acgd.nn.q_ensemble import Critic
from acgd.rollouts.windows import Windows
from acgd.store.precision import in_bfloat16
from acgd.students import losses
from acgd.students.data import Data
from acgd.students.distil import student_losses
from acgd.students.settings import CodebookConfig, StudentConfig
from acgd.students.student import Student
from acgd.students.training import adamw
from benchmarks.row import Row

TASKS, EPISODES, LENGTH = 3, 30, 100
FEATURES, PROPRIO, STATE, ACTIONS = 64, 85, 110, 39
STEPS, WARMUP = 30, 3
GEMM = 1024
MOST_GUIDANCE = 1.40


def run() -> list[Row]:
    """A behaviour-cloning step and a guided one (two dueling critics of 128 units) of the default sizes, taken in turn with a matrix product.

    Times are of the processor, so that neighbours disturb them less; the median step counts.
    """
    torch.set_num_threads(1)
    torch.manual_seed(0)
    config, settings = CodebookConfig(), StudentConfig()
    a, b = torch.randn(GEMM, GEMM), torch.randn(GEMM, GEMM)
    unguided, guided = (training_step(config, settings, with_critic) for with_critic in (False, True))
    with FlopCounterMode(display=False) as counter:
        unguided()
    flops = counter.get_total_flops()
    gemm_s, bc_s, guided_s = in_turn(lambda: a @ b, unguided, guided)
    batch = settings.training.batch
    share = flops / bc_s / (2 * GEMM**3 / gemm_s)
    return [
        Row(
            name="student/bc",
            value=batch / bc_s,
            unit="samples/s",
            ratio=share,
            target="ratio: share of the GEMM rate reached",
            met=None,
        ),
        Row(name="student/gemm", value=2 * GEMM**3 / gemm_s / 1e9, unit="GFLOP/s", ratio=None, target="", met=None),
        Row(
            name="student/guidance",
            value=batch / guided_s,
            unit="samples/s",
            ratio=guided_s / bc_s,
            target=f"ratio: <= {MOST_GUIDANCE:.2f} times the cost of behaviour cloning",
            met=guided_s / bc_s <= MOST_GUIDANCE,
        ),
    ]


def training_step(config: CodebookConfig, settings: StudentConfig, guided: bool) -> Callable[[], None]:
    """One optimiser step of stage (b), as `distil` takes it, on data of the default study's size."""
    data = Data.of(_windows(), config)
    student = Student.of(Codebook(config, Sizes(FEATURES, PROPRIO, ACTIONS, TASKS, owns_cnn=False)))
    critics = AggregateCritic(
        [Critic(STATE, ACTIONS, members=2, width=128, dueling=True) for _ in range(TASKS)], settings.pessimism
    )
    guidance = (
        Guidance(
            critics, torch.ones(TASKS), losses.step_weights(settings.guided_steps, config.chunk, torch.device("cpu"))
        )
        if guided
        else None
    )
    codes = torch.randint(config.codes, (len(data.windows.task), config.groups))
    optimiser = adamw(student, settings.training)
    trained = [p for group in optimiser.param_groups for p in group["params"]]
    generators = {name: torch.Generator().manual_seed(0) for name in ("data", "codes")}
    rows = round(settings.training.batch * settings.guided_fraction)

    def step() -> None:
        t = data.sample(settings.training.batch, generators["data"])
        batch = data.batch(t, generators["data"])
        states = data.states(t[:rows]) if guided else None
        with torch.autocast(
            "cpu", torch.bfloat16, enabled=in_bfloat16(settings.training.precision, torch.device("cpu"))
        ):
            bc, distill, _ = student_losses(
                student, batch, codes[t], guidance, states, settings.training.input_noise, generators
            )
        optimiser.zero_grad(set_to_none=True)
        (settings.alpha * bc.mean() + (distill.mean() if guided else 0)).backward()
        torch.nn.utils.clip_grad_norm_(trained, settings.training.clip_norm, foreach=True)
        optimiser.step()

    return step


def in_turn(*calls: Callable[[], object]) -> list[float]:
    """Median processor seconds of each call, the calls taken in turn, so that what slows the machine slows all of them."""
    taken: list[list[float]] = [[] for _ in calls]
    for repeat in range(WARMUP + STEPS):
        for times, call in zip(taken, calls):
            start = time.process_time()
            call()
            if repeat >= WARMUP:
                times.append(time.process_time() - start)
    return [statistics.median(times) for times in taken]


def _windows() -> Windows:
    """Random demonstrations of the default study's size."""
    steps, episodes = TASKS * EPISODES * LENGTH, TASKS * EPISODES
    index = torch.arange(steps)
    return Windows(
        steps={
            "vision": torch.randn(steps, FEATURES),
            "proprio": torch.randn(steps, PROPRIO),
            "label": torch.rand(steps, ACTIONS) * 2 - 1,
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
