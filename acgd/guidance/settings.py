"""Settings of guidance, the loss besides imitation."""

from acgd.guidance.kinds import GUIDANCE
from acgd.settings import one_of

GuidanceConfig = one_of(GUIDANCE, default="critic")
"""Settings of one kind. `needs`: stages whose artifacts the kind reads."""
