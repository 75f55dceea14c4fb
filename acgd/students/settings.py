"""Settings of the action codebook (stage a), of the student (stage b) and of acting."""

from typing import Annotated, Literal

from pydantic import Field, model_validator

from acgd.settings import OUTSIDE_KEY, Section
from acgd.tasks.settings import TaskConfig
from acgd.vision.settings import BackboneConfig

Positive = Annotated[int, Field(gt=0)]
Fraction = Annotated[float, Field(ge=0, le=1)]
NonNegative = Annotated[float, Field(ge=0)]


class TrainingConfig(Section):
    """One optimisation run: the same fields for codebook and student."""

    steps: Positive = Field(3000, description="optimiser steps")
    batch: Positive = Field(64, description="windows in a batch, spread evenly over the tasks")
    learning_rate: Annotated[float, Field(gt=0)] = Field(2e-3, description="peak learning rate of AdamW")
    schedule: Literal["cosine", "constant"] = Field("cosine", description="learning rate after the warm-up")
    warmup: Annotated[int, Field(ge=0)] = Field(100, description="steps of linear warm-up")
    weight_decay: NonNegative = Field(0.01, description="decoupled weight decay of the weight matrices")
    clip_norm: Annotated[float, Field(gt=0)] = Field(
        10.0, description="global gradient norm above which gradients are scaled down"
    )
    input_noise: NonNegative = Field(
        0.03,
        description="standard deviation of Gaussian noise on the normalised image features and proprioception while training",
    )
    precision: Literal["float32", "bfloat16"] = Field(
        "float32",
        description="arithmetic of the matrix products in training; bfloat16 is float32 where the hardware lacks it",
    )
    validate_every: Positive = Field(250, description="steps between validations; the best of them is kept")
    log_every: Positive = Field(100, description="steps between rows of metrics", json_schema_extra={"key": False})
    checkpoint_every: Positive = Field(
        500, description="steps between checkpoints for resumption", json_schema_extra={"key": False}
    )


class CodebookConfig(Section):
    """Stage (a) of Figure 2: action chunks to codes and back. The student inherits every size given here."""

    chunk: Positive = Field(8, description="k, actions in a chunk")
    history: Positive = Field(4, description="h, proprioceptive states that the policy sees, the current one included")
    groups: Positive = Field(4, description="G, codes that describe one chunk")
    codes: Annotated[int, Field(ge=2)] = Field(16, description="n_c, codes in each group")
    logits: Literal["direct", "distance"] = Field(
        "direct", description="z_e are the logits (the paper), or minus its squared distances to the codes are"
    )
    width: Positive = Field(128, description="width of every embedding, n_q of the codes included")
    heads: Positive = Field(4, description="attention heads")
    encoder_layers: Positive = Field(1, description="transformer layers of phi_act")
    decoder_layers: Positive = Field(1, description="transformer layers of psi_dec")
    expansion: Positive = Field(2, description="hidden width of feed-forward networks, in widths")
    goal_image: Literal["own", "any", "off"] = Field(
        "any",
        description="goal image o_T in training: that of any training episode of the task, as in an evaluation whose goals are "
        "training successes; the episode's own (the paper), for oracle goals; or none",
    )
    label: Literal["mean", "executed"] = Field(
        "mean", description="imitate the expert's mean or the action it executed"
    )
    action_space: Literal["raw", "excitation"] = Field(
        "raw", description="measure actions as they are, or as the muscle excitation that MyoSuite makes of them"
    )
    code_weight: NonNegative = Field(0.1, description="weight of L_code")
    usage_weight: NonNegative = Field(
        0.1, description="weight of the bonus on the entropy of the batch's mean code usage"
    )
    training: TrainingConfig = Field(TrainingConfig(), description="optimisation")

    @model_validator(mode="after")
    def _heads_divide_width(self) -> "CodebookConfig":
        if self.width % self.heads:
            raise ValueError(
                f"width {self.width} is no multiple of heads {self.heads}; choose e.g. width {self.heads * (self.width // self.heads + 1)}"
            )
        return self


class StudentConfig(Section):
    """Stage (b) of Figure 2: behaviour cloning of codes and actions, with or without the critics."""

    guidance: Literal["none", "critic"] = Field(
        "critic", description="critic: add L_distill; none: behaviour cloning alone"
    )
    gate: Literal["one", "reliable"] = Field(
        "one", description="one: every task is guided (the paper); reliable: only tasks whose critic ranks actions well"
    )
    reliable_rank: float = Field(
        0.2, description="gate reliable: least low end of the interval of the within-state rank correlation"
    )
    guided_steps: Literal["chunk", "first"] = Field(
        "chunk", description="actions the critic judges: every step of the chunk, or the first"
    )
    guided_fraction: Annotated[float, Field(gt=0, le=1)] = Field(
        0.25, description="share of each batch the critics see; the expectation of L_distill does not depend on it"
    )
    alpha: Annotated[float, Field(gt=0)] = Field(
        10.0, description="alpha, weight of L_BC against L_distill, Eq. (1); the loss is divided by it"
    )
    pessimism: NonNegative = Field(1.0, description="standard deviations of the critic ensemble taken off its mean")
    training: TrainingConfig = Field(TrainingConfig(), description="optimisation")


class ActingConfig(Section):
    """How overlapping chunks become one action per step (Section III-A)."""

    mode: Literal["ensemble-paper", "ensemble-act", "first", "open-loop"] = Field(
        "ensemble-paper",
        description="average the chunks that cover the step, weighing the newest (paper) or the oldest (ACT) most; "
        "or take each new chunk's first action; or execute whole chunks",
    )
    eta: NonNegative = Field(2.0, description="eta of the ensembling weights exp(-eta i)")


class RoundsConfig(Section):
    """On-policy rounds: the student acts, and goes on learning from the states that it visits."""

    count: int = Field(0, ge=0, le=100, description="rounds after the demonstrations", json_schema_extra=OUTSIDE_KEY)
    episodes: int = Field(10, ge=1, le=10_000, description="episodes of each task in each round")
    beta: Annotated[float, Field(ge=0, le=1)] = Field(
        0.5, description="with probability beta ** round the expert acts in place of the student"
    )
    labels: Literal["expert", "none"] = Field(
        "expert",
        description="expert: imitate the expert's mean in visited states (DAgger); none: guidance alone trains on them",
    )
    steps: int = Field(1000, ge=1, description="optimiser steps of each round, in place of training.steps")


class CodebookRequest(Section):
    """What one codebook depends on, besides its inputs."""

    tasks: list[TaskConfig]
    codebook: CodebookConfig
    backbone: BackboneConfig
    seed: Annotated[int, Field(ge=0)]


class StudentRequest(Section):
    """What one student depends on, besides its inputs."""

    tasks: list[TaskConfig]
    codebook: CodebookConfig
    student: StudentConfig
    backbone: BackboneConfig
    seed: Annotated[int, Field(ge=0)]
