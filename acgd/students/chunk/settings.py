"""Settings of the student chunk."""

from typing import ClassVar, Literal

from acgd.students.transformer_settings import TransformerSettings


class ChunkConfig(TransformerSettings):
    """acgd without codes: the same encoders and decoder, trained with an L1 loss of the chunk only."""

    needs: ClassVar[tuple[str, ...]] = ()

    kind: Literal["chunk"] = "chunk"
