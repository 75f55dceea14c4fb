"""No guidance: imitation is the only loss."""

import torch

from acgd.guidance.none.settings import NoGuidanceConfig
from acgd.store.stage import Inputs


def load(settings: NoGuidanceConfig, inputs: Inputs, *, chunk: int, device: torch.device) -> None:
    """Returns None: the kind has no critics."""
