"""Settings of the student of the paper: its architecture and its codebook."""

from typing import Annotated, ClassVar, Literal

from pydantic import Field, model_validator

from acgd.settings import Section
from acgd.students.training_settings import TrainingConfig

Positive = Annotated[int, Field(ge=1)]
NonNegative = Annotated[float, Field(ge=0)]


class CodebookConfig(Section):
    """Stage (a) of Figure 2: action chunks to codes and back. Its sizes are the student's."""

    code_weight: NonNegative = Field(0.1, description="weight of L_code")
    usage_weight: NonNegative = Field(
        0.1, description="weight of the bonus on the entropy of the batch's mean code usage"
    )
    training: TrainingConfig = Field(TrainingConfig(), description="optimisation")


class ACGDConfig(Section):
    """The paper's student: codes of an action chunk, predicted from the observation and decoded (Figure 2)."""

    needs: ClassVar[tuple[str, ...]] = ("codebook",)
    recurrent: ClassVar[bool] = False

    kind: Literal["acgd"] = "acgd"
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
    codebook: CodebookConfig = Field(CodebookConfig(), description="Stage codebook, one artifact for each student seed")

    @model_validator(mode="after")
    def _heads_divide_width(self) -> "ACGDConfig":
        if self.width % self.heads:
            multiple = self.heads * (self.width // self.heads + 1)
            raise ValueError(f"width {self.width} is no multiple of heads {self.heads}; choose e.g. width {multiple}")
        return self
