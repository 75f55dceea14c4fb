"""What a kind of student is. The stage `student`, evaluation and on-policy rounds know nothing else of it."""

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
    """What the data dictate."""

    features: int
    """F, of one frame."""
    proprio: int
    actions: int
    tasks: int
    owns_cnn: bool
    """The student reads images through a CNN of its own, `features` wide, and no features of a frozen backbone."""
    goal: int = 0
    """G, numbers in a commanded goal. 0 for students that are given none."""


@dataclass(frozen=True)
class Imitation:
    """What one forward pass gives both losses."""

    loss: Tensor
    """(B,) L_BC of each window."""
    proposal: Tensor | None
    """(n, k, A) chunks for the first n windows, in the box, with a gradient. None where none were wanted."""
    metrics: dict[str, Tensor]
    """Name -> (B,), for the curves."""


class Student(Protocol):
    """An nn.Module of one kind.

    Its settings say `chunk` k and `history` h, the steps of its windows, and `needs`, further stages that it reads. Its
    state dict is all that it has learned.
    """

    settings: Section
    imitation: ImitationConfig
    sizes: Sizes

    def __init__(self, settings: Section, imitation: ImitationConfig, sizes: Sizes) -> None:
        """Weights are drawn from torch's global generator, which the caller seeds."""

    def initialise(self, data: Data, inputs: Inputs) -> None:
        """Before round 0: fit the normalisers to the data, and take over what was learned upstream."""

    def prepare(self, data: Data, inputs: Inputs) -> dict[str, Tensor]:
        """Before each round: targets of every window, name -> (N, ...), which batches then hold."""

    def imitate(self, batch: Batch, *, guided: int, noise: float, generators: Generators) -> Imitation:
        """One training step. `guided`: how many first windows need a proposal. `noise`: of the inputs.

        Generators: `data` for the noise; `sample` for the student's samples of proposals, so that a guided and an
        unguided student of one seed see the same batches.
        """

    def validate(self, batch: Batch) -> dict[str, Tensor]:
        """Scores of held-out windows besides the error of `plan`, name -> (B,)."""

    def plan(self, observation: Observation) -> Tensor:
        """The likeliest chunk (B, k, A) in the box, without a gradient."""

    def policy(self, acting: ActingConfig) -> Policy:
        """It acts on `vision`, the goals and `proprio`, as in an Observation: see acgd.students.perception."""
