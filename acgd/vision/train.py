"""The stage `backbone`: trains a backbone, or converts a file of pretrained weights."""

from acgd.settings import imported
from acgd.store.stage import Context, Inputs
from acgd.vision.kinds import BACKBONES
from acgd.vision.settings import BackboneRequest


def train(request: BackboneRequest, inputs: Inputs, ctx: Context) -> None:
    """Writes backbone.json and, unless the kind is `scratch`, the weights."""
    imported(BACKBONES[request.backbone.kind].code).make(request.backbone, inputs, ctx)
