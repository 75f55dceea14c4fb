"""Settings of critics: source, fit, and measurement of quality."""

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, PositiveFloat, PositiveInt, model_validator

from acgd.critics.kinds import CRITICS
from acgd.experts import zoo
from acgd.settings import OUTSIDE_KEY, Request, Section, one_of
from acgd.tasks.settings import TaskConfig


class PerturbationConfig(Section):
    """Perturbation of the expert's mean action while transitions are gathered, in shares of the simulator steps."""

    clean: float = Field(0.5, ge=0, le=1, description="Share of steps in episodes that follow the expert's mean.")
    gaussian: float = Field(0.3, ge=0, le=1, description="Share in episodes with fresh Gaussian noise at every step.")
    bursts: float = Field(
        0.2, ge=0, le=1, description="Share in episodes with held noise now and then; the expert recovers between."
    )
    scales: tuple[PositiveFloat, ...] = Field(
        (0.1, 0.2, 0.4), min_length=1, description="Standard deviations of the Gaussian noise, one per episode in turn."
    )
    burst_scale: PositiveFloat = Field(0.5, description="Standard deviation of the offset held during a burst.")
    burst_steps: PositiveInt = Field(5, description="Length of a burst in steps.")
    burst_every: PositiveInt = Field(25, description="Mean number of clean steps between two bursts.")

    @model_validator(mode="after")
    def _shares_sum_to_one(self) -> "PerturbationConfig":
        total = self.clean + self.gaussian + self.bursts
        if abs(total - 1) > 1e-6:
            raise ValueError(f"clean + gaussian + bursts is {total:g}; make the three shares sum to 1")
        return self


class BranchConfig(Section):
    """Branches: several actions from one simulator state, each followed by the expert, to teach the actions' order."""

    states: int = Field(
        500, ge=0, description="States that branches start from, drawn from the rollouts. 0 fits on rollouts alone."
    )
    actions: int = Field(4, ge=2, description="Actions in each state.")
    steps: PositiveInt = Field(
        16, description="Simulator steps of a branch, its first action included, before Q is bootstrapped."
    )


Spread = Annotated[
    Literal["all", "near"],
    Field(
        description="Candidate actions whose Q sets the unit of guidance: all sixteen, of which three are uniform in "
        "the box, or only those near the expert's action."
    ),
]


class FQESettings(Section):
    """Q of the frozen expert by fitted Q evaluation with an ensemble of LayerNorm networks."""

    kind: Literal["fqe"] = "fqe"
    members: PositiveInt = Field(2, description="Networks in the ensemble.")
    width: PositiveInt = Field(128, description="Units of a hidden layer.")
    depth: PositiveInt = Field(2, description="Hidden layers.")
    dueling: bool = Field(True, description="Q = V(s) + A(s, a) with two networks; false: one network.")
    action_space: Literal["raw", "excitation"] = Field(
        "excitation", description="Critic input: raw actions, or the muscle excitation of MyoSuite."
    )
    steps: PositiveInt = Field(
        6000, description="Simulator steps of rollouts, to the end of the last episode. Branches add to them."
    )
    perturbation: PerturbationConfig = Field(PerturbationConfig(), description="Noise on the expert's actions.")
    branches: BranchConfig = Field(BranchConfig(), description="Several actions tried in one state.")
    horizon: PositiveInt = Field(
        64,
        description="Most rewards summed before bootstrapping, while actions follow the expert's mean. 1 is "
        "one-step fitted Q evaluation.",
    )
    updates: PositiveInt = Field(5000, description="Gradient steps.")
    batch: PositiveInt = Field(256, description="Transitions in a gradient step, for the regression on y.")
    branch_batch: PositiveInt = Field(
        64, description="Branched states in a gradient step, for the within-state regression."
    )
    lr: PositiveFloat = Field(1e-3, description="Learning rate of Adam, annealed to zero by a cosine.")
    weight_decay: float = Field(1.0, ge=0, description="Decoupled weight decay.")
    target_every: PositiveInt = Field(
        100, description="Updates between two recomputations of the targets of all transitions."
    )
    within_state: float = Field(
        1.0, ge=0, description="Weight of the regression of differences between actions of one branched state."
    )
    within_state_unit: Literal["spread", "distance"] = Field(
        "spread",
        description="Unit of these differences. spread: spread of the state's returns. distance: distance of the two "
        "actions times the slope of the state's returns, so that close actions weigh as much as distant ones.",
    )
    state_noise: float = Field(
        0.0,
        ge=0,
        description="Standard deviation of Gaussian noise on normalised states in both regressions, one draw for all "
        "actions of a branched state.",
    )
    spread: Spread = "all"
    seed: int = Field(0, ge=0, description="Seed of initialisation, batches and perturbations.")
    checkpoint_every: PositiveInt = Field(
        1000, description="Updates between two checkpoints.", json_schema_extra=OUTSIDE_KEY
    )

    @model_validator(mode="after")
    def _enough_states_to_branch_from(self) -> "FQESettings":
        if self.branches.states > self.steps:
            raise ValueError(
                f"{self.branches.states} branched states are drawn from the rollouts, and these have {self.steps} "
                "steps. Raise critic.steps, or lower critic.branches.states."
            )
        return self

    def files(self, task: str) -> tuple[Path, ...]:
        """No files."""
        return ()

    def faults(self, task: str, expert: Any) -> Iterator[str]:
        """No messages: every expert can be evaluated."""
        return iter(())


class ZooCriticSettings(Section):
    """The critic in zoo/, which was fitted to the expert in zoo/."""

    kind: Literal["zoo"] = "zoo"

    def files(self, task: str) -> tuple[Path, ...]:
        """Files of the critic."""
        return zoo.fitted_critic(task)

    def faults(self, task: str, expert: Any) -> Iterator[str]:
        """Messages where the zoo has no critic, or the expert is not that of the zoo."""
        if expert.kind != "zoo":
            yield (
                f"critic.kind: the critics in zoo/ judge the experts there, and {task} trains one. "
                "Set critic.kind: fqe, or expert.kind: zoo."
            )
        elif not zoo.has_fitted_critic(task):
            yield (
                f"critic.kind: zoo/ has no critic for {task}. "
                f"Set critic.kind: fqe, or take tasks whose critics it has: {zoo.tasks_with(zoo.has_fitted_critic)}."
            )


class ExpertCriticSettings(Section):
    """The critics that an off-policy expert (SAC) trained with its policy. Rollouts measure the spread of their Q."""

    kind: Literal["expert"] = "expert"
    steps: PositiveInt = Field(6000, description="Simulator steps of these rollouts, to the end of the last episode.")
    perturbation: PerturbationConfig = Field(PerturbationConfig(), description="Noise on the expert's actions.")
    spread: Spread = "all"
    seed: int = Field(0, ge=0, description="Seed of perturbations and of the actions whose Q is compared.")

    def files(self, task: str) -> tuple[Path, ...]:
        """No files."""
        return ()

    def faults(self, task: str, expert: Any) -> Iterator[str]:
        """A message where the expert has no critics."""
        if not expert.has_critics(task):
            what = (
                f"the expert in zoo/ for {task}" if expert.kind == "zoo" else f"the expert that is trained for {task}"
            )
            yield (
                f"critic.kind: {what} has no critics, only an off-policy learner trains them. Set critic.kind: fqe, "
                f"expert.kind: sac, or take a task whose expert in zoo/ has critics: "
                f"{zoo.tasks_with(zoo.has_learned_critics)}."
            )


CriticConfig = one_of(CRITICS, default="fqe")


class CriticRequest(Request):
    """Request of the stage `critic`."""

    task: TaskConfig
    critic: CriticConfig = Field(FQESettings(), description="Stage `critic`, one artifact per task.")

    def files(self) -> tuple[Path, ...]:
        """Files of the critic in zoo/, for the source `zoo`."""
        return self.critic.files(self.task.name)


class QualityConfig(Section):
    """Measurement of a critic's quality on held-out episodes."""

    states: int = Field(
        32,
        ge=2,
        description="Held-out perturbed episodes. Candidate actions are ranked in one state of each.",
    )
    candidates: int = Field(16, ge=4, description="Candidate first actions in a state.")
    tail: PositiveInt = Field(
        40,
        description="Steps simulated per candidate, past the time limit if needed. The remainder weighs gamma^tail.",
    )
    perturbation: PerturbationConfig = Field(PerturbationConfig(), description="Perturbation of these episodes.")
    seed: int = Field(0, ge=0, description="Seed of perturbations, states and candidates.")

    @model_validator(mode="after")
    def _has_a_clean_episode(self) -> "QualityConfig":
        if self.perturbation.clean * self.states < 1 - 1e-9:
            raise ValueError(
                f"none of {self.states} episodes would be clean, and the correlation with returns is measured on "
                "these. Raise quality.perturbation.clean or quality.states."
            )
        return self


class QualityRequest(Request):
    """Request of the stage `quality`."""

    task: TaskConfig
    quality: QualityConfig = Field(QualityConfig(), description="Stage `quality`, one artifact per task.")
