"""Settings of the students that plan a chunk with a transformer: acgd, act and chunk."""

from typing import Annotated, ClassVar

from pydantic import Field, model_validator

from acgd.settings import Section

Positive = Annotated[int, Field(ge=1)]


class TransformerSettings(Section):
    """Lengths of a window, and sizes of the transformers."""

    recurrent: ClassVar[bool] = False

    chunk: Positive = Field(8, description="Actions in a chunk, k.")
    history: Positive = Field(
        4, description="Proprioceptive states that the policy reads, h, including the current one."
    )
    width: Positive = Field(128, description="Width of every embedding, including n_q of acgd's codes.")
    heads: Positive = Field(4, description="Attention heads.")
    decoder_layers: Positive = Field(1, description="Transformer layers of psi_dec.")
    expansion: Positive = Field(2, description="Hidden width of feed-forward networks, in multiples of `width`.")

    @model_validator(mode="after")
    def _heads_divide_width(self) -> "TransformerSettings":
        if self.width % self.heads:
            multiple = self.heads * (self.width // self.heads + 1)
            raise ValueError(f"width {self.width} is no multiple of heads {self.heads}. Choose e.g. width {multiple}.")
        return self
