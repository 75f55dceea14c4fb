"""All kinds of guidance: one line and one folder each.

The code is a function `load(settings, inputs, chunk=, device=) -> Guidance | None`, see acgd/guidance/guidance.py.
"""

from acgd.settings import Kind

GUIDANCE: dict[str, Kind] = {
    "none": Kind("acgd.guidance.none.settings:NoGuidanceConfig", "acgd.guidance.none.guidance:load"),
    "critic": Kind("acgd.guidance.critic.settings:CriticGuidanceConfig", "acgd.guidance.critic.guidance:load"),
}
