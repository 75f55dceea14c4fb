"""Sources of critics. A new source is one file and one line."""

from acgd.settings import Kind

CRITICS: dict[str, Kind] = {
    "fqe": Kind("acgd.critics.settings:FQESettings", "acgd.critics.fqe:fit"),
    "zoo": Kind("acgd.critics.settings:ZooCriticSettings", "acgd.critics.pretrained:from_zoo"),
    "expert": Kind("acgd.critics.settings:ExpertCriticSettings", "acgd.critics.pretrained:from_expert"),
}
"""The code is `function(request, expert, ctx) -> None`. `expert` is the expert's folder. The function writes
critic.safetensors and critic.json into `ctx.out`."""
