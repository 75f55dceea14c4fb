"""Settings of the recurrent behaviour-cloning student."""

from typing import Annotated, ClassVar, Literal

from pydantic import Field

from acgd.settings import Section


class BCRNNConfig(Section):
    """BC-RNN (robomimic): an LSTM over windows of observations, with a mixture of Gaussians over each action."""

    needs: ClassVar[tuple[str, ...]] = ()
    history: ClassVar[int] = 1
    recurrent: ClassVar[bool] = True

    kind: Literal["bc_rnn"] = "bc_rnn"
    sequence: int = Field(10, ge=1, description="Observations and actions in a training window.")
    reset: bool = Field(
        True,
        description="true: the memory is reset every `sequence` steps of an episode, as in training (robomimic). "
        "false: it lasts for the whole episode.",
    )
    width: int = Field(400, ge=1, description="Units of each layer. robomimic: 400 without images, 1000 with images.")
    layers: int = Field(2, ge=1, description="LSTM layers.")
    head: Literal["gmm", "l1"] = Field(
        "gmm",
        description="Output and loss. gmm: a mixture of Gaussians over each action, and its negative log likelihood. "
        "l1: one action, and the 1-norm of its error.",
    )
    modes: int = Field(5, ge=1, description="Gaussians of the mixture. The head `l1` ignores it.")
    least_std: Annotated[float, Field(gt=0)] = Field(
        1e-4, description="Least standard deviation of a Gaussian of the mixture. The head `l1` ignores it."
    )

    @property
    def chunk(self) -> int:
        """Actions in a window, k: one for each observation."""
        return self.sequence
