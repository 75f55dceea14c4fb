"""The error by which every kind of student imitates and is chosen."""

from torch import Tensor

from acgd.nn.excitation import ActionSpace, to_loss_space
from acgd.nn.losses import l1
from acgd.students.data import Batch


def l1_error(chunk: Tensor, batch: Batch, space: ActionSpace) -> Tensor:
    """Mean over valid steps of the 1-norm of the error against the labels, (B, k, A) -> (B,)."""
    return l1(to_loss_space(chunk, space), to_loss_space(batch.chunk, space), batch.mask)
