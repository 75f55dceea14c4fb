"""Settings of the student that plans a chunk without codes."""

from typing import ClassVar, Literal

from acgd.students.transformer_settings import TransformerSettings


class ChunkConfig(TransformerSettings):
    """acgd without codes: the same encoders and decoder, trained by an L1 loss of the chunk alone."""

    needs: ClassVar[tuple[str, ...]] = ()

    kind: Literal["chunk"] = "chunk"
