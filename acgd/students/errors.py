"""The L1 error of a chunk: a loss of students, and the error that selects their best weights."""

from torch import Tensor

from acgd.nn.excitation import ActionSpace, to_loss_space
from acgd.nn.losses import l1
from acgd.students.data import Batch


def l1_error(chunk: Tensor, batch: Batch, space: ActionSpace) -> Tensor:
    """Mean over valid steps of the 1-norm of the error against the labels: chunk (B, k, A) -> (B,)."""
    return l1(to_loss_space(chunk, space), to_loss_space(batch.chunk, space), batch.mask)
