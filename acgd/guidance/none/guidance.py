"""No guidance: imitation alone."""

import torch

from acgd.guidance.none.settings import NoGuidanceConfig
from acgd.store.stage import Inputs


def load(settings: NoGuidanceConfig, inputs: Inputs, *, chunk: int, device: torch.device) -> None:
    """There is nothing to load."""
