"""Settings of the paper's student: architecture and codebook."""

from typing import Annotated, ClassVar, Literal

from pydantic import Field

from acgd.settings import Section
from acgd.students.training_settings import TrainingConfig
from acgd.students.transformer_settings import Positive, TransformerSettings

NonNegative = Annotated[float, Field(ge=0)]


class CodebookConfig(Section):
    """Stage (a) of Figure 2: action chunks to codes and back. The student's settings give the sizes."""

    code_weight: NonNegative = Field(0.1, description="Weight of L_code.")
    usage_weight: NonNegative = Field(
        0.1, description="Weight of the bonus on the entropy of the batch's mean code usage."
    )
    training: TrainingConfig = Field(TrainingConfig(), description="Optimisation of the codebook.")


class ACGDConfig(TransformerSettings):
    """The paper's student. It predicts codes of an action chunk from the observation and decodes them (Figure 2)."""

    needs: ClassVar[tuple[str, ...]] = ("codebook",)

    kind: Literal["acgd"] = "acgd"
    groups: Positive = Field(4, description="Codes that describe one chunk, G.")
    codes: Annotated[int, Field(ge=2)] = Field(16, description="Codes in each group, n_c.")
    logits: Literal["direct", "distance"] = Field(
        "direct",
        description="Logits of the codes. direct: z_e (the paper). distance: the negative squared distances of z_e to "
        "the codes.",
    )
    encoder_layers: Positive = Field(1, description="Transformer layers of phi_act.")
    codebook: CodebookConfig = Field(
        CodebookConfig(), description="Stage `codebook`, one artifact for each student seed."
    )
