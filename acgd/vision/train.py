"""The stage `backbone`: trained, or converted once from a file that somebody else trained."""

from acgd.artifacts.stage import Context, Inputs
from acgd.config.vision import BackboneRequest
from acgd.vision.backbones import BACKBONES


def train(config: BackboneRequest, inputs: Inputs, ctx: Context) -> None:
    """Write backbone.json and, unless the kind is `scratch`, the weights."""
    BACKBONES[config.backbone.kind].make(config, inputs, ctx)
