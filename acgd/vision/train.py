"""The stage `backbone`: trained, or converted once from a file that somebody else trained."""

from acgd.store.stage import Context, Inputs
from acgd.vision.backbones import BACKBONES
from acgd.vision.settings import BackboneRequest


def train(config: BackboneRequest, inputs: Inputs, ctx: Context) -> None:
    """Write backbone.json and, unless the kind is `scratch`, the weights."""
    BACKBONES[config.backbone.kind].make(config, inputs, ctx)
