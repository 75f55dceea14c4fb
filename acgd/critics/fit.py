"""The critic stage: Q(s, a) of a frozen expert."""

from acgd.critics.kinds import CRITICS
from acgd.critics.settings import CriticRequest
from acgd.settings import imported
from acgd.store.stage import Context, Inputs


def fit(request: CriticRequest, inputs: Inputs, ctx: Context) -> None:
    """{expert} -> critic.safetensors, critic.json."""
    imported(CRITICS[request.critic.kind].code)(request, inputs["expert"], ctx)
