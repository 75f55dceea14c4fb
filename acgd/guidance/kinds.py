"""The registry of guidance kinds: one line and one folder per kind.

The code of a kind is a function `load(settings, inputs, chunk=, device=) -> Guidance | None`, see guidance.py.
"""

from acgd.settings import Kind

GUIDANCE: dict[str, Kind] = {
    "none": Kind("acgd.guidance.none.settings:NoGuidanceConfig", "acgd.guidance.none.guidance:load"),
    "critic": Kind("acgd.guidance.critic.settings:CriticGuidanceConfig", "acgd.guidance.critic.guidance:load"),
}
