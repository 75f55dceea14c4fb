"""What the registry says of a task."""

from dataclasses import dataclass


@dataclass(frozen=True)
class TaskSpec:
    """A task as the pipeline sees it. Importing it loads no simulator."""

    name: str
    """`<suite>/<task>`, the name in configurations and reports."""
    suite: str
    """Tasks of a suite share their action and proprio spaces."""
    kind: str
    """Which state layout, start distribution and camera it has: `key-turn`, `obj-hold`, ..."""
    gym_id: str | None
    """MyoSuite's own environment; None in the suites that are built here."""
    horizon: int
    """Steps to the time limit."""
    privileged: tuple[str, ...]
    """Entries of the state that hold object and goal: what vision has to find out."""
    goal: str
    """Where the goal varies, and where a policy without the state can see it."""

    @property
    def slug(self) -> str:
        """The name as part of a path: `myo-key-turn`."""
        return self.name.replace("/", "-")
