"""The critic section: data, fit and quality of one expert's Q."""

from typing import Literal

from pydantic import Field, PositiveFloat, PositiveInt, model_validator

from acgd.settings import Section
from acgd.tasks.settings import TaskConfig


class PerturbationConfig(Section):
    """What is done to the expert's mean action while transitions are gathered, by shares of the simulator steps."""

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
    """Several actions tried from one simulator state, each followed by the expert: what ranks actions within a state."""

    states: int = Field(
        500, ge=0, description="States branched from, drawn from the rollouts. 0 fits on rollouts alone."
    )
    actions: int = Field(4, ge=2, description="Actions tried in each state.")
    steps: PositiveInt = Field(
        16, description="Simulator steps of a branch, its first action included, before Q is bootstrapped."
    )


class QualityConfig(Section):
    """How a fitted critic is judged, on episodes that the fit has not seen."""

    states: int = Field(
        32,
        ge=2,
        description="Held-out episodes, perturbed like those of the fit; in one state of each, candidate actions are ranked.",
    )
    candidates: int = Field(16, ge=4, description="Candidate first actions in a state.")
    tail: PositiveInt = Field(
        40,
        description="Steps simulated per candidate, past the time limit if need be; what is cut off weighs gamma^tail.",
    )


class CriticConfig(Section):
    """Q of a frozen expert: by fitted Q evaluation with an ensemble of LayerNorm networks, ready from zoo/, or the expert's own."""

    source: Literal["fqe", "zoo", "expert"] = Field(
        "fqe",
        description="fqe: fitted to the frozen expert; zoo: the one so fitted that lies beside the expert in zoo/; expert: the critics that an off-policy "
        "expert (SAC) has learned.",
    )
    members: PositiveInt = Field(2, description="Networks in the ensemble.")
    width: PositiveInt = Field(128, description="Units of a hidden layer.")
    depth: PositiveInt = Field(2, description="Hidden layers.")
    dueling: bool = Field(True, description="Q = V(s) + A(s, a), a network each; without it one network for both.")
    action_space: Literal["raw", "excitation"] = Field(
        "excitation", description="Read actions as they are, or as the muscle excitation that MyoSuite makes of them."
    )
    steps: PositiveInt = Field(
        6000, description="Simulator steps of rollouts, to the end of the last episode; branches come on top."
    )
    perturbation: PerturbationConfig = PerturbationConfig()
    branches: BranchConfig = BranchConfig()
    horizon: PositiveInt = Field(
        64,
        description="Rewards summed before bootstrapping while the expert's mean is followed; 1 is one-step fitted Q evaluation.",
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
        description="Unit of these differences: the spread of the state's returns, or the distance of the two actions times the slope of the state's returns, "
        "so that actions close to each other count like far ones.",
    )
    state_noise: float = Field(
        0.0,
        ge=0,
        description="Standard deviation of Gaussian noise on normalised states in both regressions, one draw for all actions of a branched state.",
    )
    seed: int = Field(0, ge=0, description="Seed of initialisation, batches and perturbations.")
    checkpoint_every: PositiveInt = Field(
        1000, description="Updates between two checkpoints.", json_schema_extra={"key": False}
    )
    quality: QualityConfig = QualityConfig()


class CriticRequest(Section):
    """What the critic of one task depends on, besides the expert's artifact."""

    task: TaskConfig
    critic: CriticConfig
