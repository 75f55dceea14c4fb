"""The interface of a student kind. The stages that train and run a student use this interface only."""

from dataclasses import dataclass
from typing import Protocol

from torch import Tensor

from acgd.settings import Section
from acgd.simulate.policy import Policy
from acgd.store.checkpoint import Generators
from acgd.store.stage import Inputs
from acgd.students.data import Batch, Data, Observation
from acgd.students.settings import ActingConfig, ImitationConfig


@dataclass(frozen=True)
class Sizes:
    """Sizes that the data determine: F of one frame, P, A and the number of tasks."""

    features: int
    proprio: int
    actions: int
    tasks: int
    owns_cnn: bool
    """Whether the student reads images through a CNN that it trains, with `features` outputs, and no features."""
    goal: int = 0
    """G of commanded goals; 0 for a student without them."""


@dataclass(frozen=True)
class Imitation:
    """Result of one forward pass, for imitation and guidance."""

    loss: Tensor
    """(B,) L_BC of each window."""
    proposal: Tensor | None
    """(n, k, A) chunks for the first n windows, inside the box, with a gradient. None for n = 0."""
    metrics: dict[str, Tensor]
    """Name -> (B,), logged as curves."""


class Student(Protocol):
    """An nn.Module of one kind.

    The settings have `chunk` k and `history` h, the lengths of a window; `recurrent`, whether a window has an
    observation for each of its actions; and `needs`, the optional stages that the kind reads. The state dict holds
    everything that is learned.
    """

    settings: Section
    imitation: ImitationConfig
    sizes: Sizes

    def __init__(self, settings: Section, imitation: ImitationConfig, sizes: Sizes) -> None:
        """Draws the weights from torch's global generator, which the caller seeds."""

    def initialise(self, data: Data, inputs: Inputs) -> None:
        """Before round 0: fits the normalisers to the data, and loads weights of upstream stages."""

    def prepare(self, data: Data, inputs: Inputs) -> dict[str, Tensor]:
        """Before each round: returns targets of every window, name -> (N, ...). Batches contain them."""

    def imitate(self, batch: Batch, *, guided: int, noise: float, generators: Generators) -> Imitation:
        """The forward pass of one training step.

        guided: number of windows, from the first on, that need a proposal. noise: standard deviation of the noise on
        normalised inputs. Generators: `data` for the noise, `sample` for the samples of proposals. The second generator
        gives guided and unguided students of one seed the same batches.
        """

    def validate(self, batch: Batch) -> dict[str, Tensor]:
        """Scores of held-out windows in addition to the error of `plan`, name -> (B,)."""

    def plan(self, observation: Observation) -> Tensor:
        """The likeliest chunk (B, k, A) inside the box, without a gradient."""

    def policy(self, acting: ActingConfig) -> Policy:
        """A policy that reads `vision`, goals and `proprio`, each in the form of Observation: see Perception."""
