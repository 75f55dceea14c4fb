"""Where a critic comes from. A new source is a file and a line."""

from acgd.settings import Kind

CRITICS: dict[str, Kind] = {
    "fqe": Kind("acgd.critics.settings:FQESettings", "acgd.critics.fqe:fit"),
    "zoo": Kind("acgd.critics.settings:ZooCriticSettings", "acgd.critics.given:from_zoo"),
    "expert": Kind("acgd.critics.settings:ExpertCriticSettings", "acgd.critics.given:from_expert"),
}
"""The code is `function(request, expert, ctx) -> None`, with the folder of the expert: it writes critic.safetensors and
critic.json."""
