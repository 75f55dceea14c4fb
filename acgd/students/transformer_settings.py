"""Settings that the students which decode a chunk by a transformer share."""

from typing import Annotated

from pydantic import Field, model_validator

from acgd.settings import Section

Positive = Annotated[int, Field(ge=1)]


class TransformerSettings(Section):
    """Windows and widths."""

    chunk: Positive = Field(8, description="Actions in a chunk, k.")
    history: Positive = Field(
        4, description="Proprioceptive states that the policy reads, h, including the current one."
    )
    width: Positive = Field(128, description="Width of every embedding, including n_q of the codes of acgd.")
    heads: Positive = Field(4, description="Attention heads.")
    decoder_layers: Positive = Field(1, description="Transformer layers of psi_dec.")
    expansion: Positive = Field(2, description="Hidden width of feed-forward networks, in multiples of `width`.")

    @model_validator(mode="after")
    def _heads_divide_width(self) -> "TransformerSettings":
        if self.width % self.heads:
            multiple = self.heads * (self.width // self.heads + 1)
            raise ValueError(f"width {self.width} is no multiple of heads {self.heads}. Choose e.g. width {multiple}.")
        return self
