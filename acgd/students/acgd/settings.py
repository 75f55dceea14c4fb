"""Settings of the student of the paper: its architecture and its codebook."""

from typing import Annotated, ClassVar, Literal

from pydantic import Field

from acgd.settings import Section
from acgd.students.training_settings import TrainingConfig
from acgd.students.transformer_settings import Positive, TransformerSettings

NonNegative = Annotated[float, Field(ge=0)]


class CodebookConfig(Section):
    """Stage (a) of Figure 2: action chunks to codes and back. Its sizes are the student's."""

    code_weight: NonNegative = Field(0.1, description="weight of L_code")
    usage_weight: NonNegative = Field(
        0.1, description="weight of the bonus on the entropy of the batch's mean code usage"
    )
    training: TrainingConfig = Field(TrainingConfig(), description="optimisation")


class ACGDConfig(TransformerSettings):
    """The paper's student: codes of an action chunk, predicted from the observation and decoded (Figure 2)."""

    needs: ClassVar[tuple[str, ...]] = ("codebook",)

    kind: Literal["acgd"] = "acgd"
    groups: Positive = Field(4, description="G, codes that describe one chunk")
    codes: Annotated[int, Field(ge=2)] = Field(16, description="n_c, codes in each group")
    logits: Literal["direct", "distance"] = Field(
        "direct", description="z_e are the logits (the paper), or minus its squared distances to the codes are"
    )
    encoder_layers: Positive = Field(1, description="transformer layers of phi_act")
    codebook: CodebookConfig = Field(CodebookConfig(), description="Stage codebook, one artifact for each student seed")
