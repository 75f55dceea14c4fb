"""Settings of ACT."""

from typing import Annotated, ClassVar, Literal

from pydantic import Field

from acgd.students.transformer_settings import Positive, TransformerSettings


class ACTConfig(TransformerSettings):
    """ACT (Zhao et al. 2023), a CVAE of action chunks. One decoder layer is the published form: its code has seven and
    uses the output of the first. More layers are the corrected form.
    """

    needs: ClassVar[tuple[str, ...]] = ()

    kind: Literal["act"] = "act"
    latent: Positive = Field(32, description="Components of z.")
    kl_weight: Annotated[float, Field(ge=0)] = Field(
        10.0, description="Weight of the KL divergence of z against the mean absolute error of an action component."
    )
    style_layers: Positive = Field(1, description="Transformer layers of the style encoder, which reads the labels.")
    encoder_layers: Positive = Field(1, description="Transformer layers over the tokens of the observation and z.")
