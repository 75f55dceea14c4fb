"""Settings: frozen, typed, unknown keys refused. No `settings.py` imports torch or a simulator."""

from collections.abc import Iterator, Mapping
from importlib import import_module
from pathlib import Path
from typing import Annotated, Any, NamedTuple, Union

from pydantic import BaseModel, ConfigDict, Discriminator, Tag

OUTSIDE_KEY = {"key": False}
"""`json_schema_extra` of a field that changes how an artifact is made and not what it is: no key depends on it."""


class Section(BaseModel):
    """A frozen part of the configuration; unknown keys are refused."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class Request(Section):
    """All that one artifact depends on besides its inputs.

    The plan fills every field by its name. `task` (TaskConfig), `tasks`, `seed`, `round` and `condition` are those of
    the artifact. Any other field is the variant's section of that name.
    """

    def uses(self, stage: str) -> bool:
        """Whether this artifact reads a stage that the table of stages marks as optional."""
        return True

    def exists(self) -> bool:
        """Whether a variant with these settings has such an artifact at all."""
        return True

    def files(self) -> tuple[Path, ...]:
        """Files outside the store that the stage reads. The key holds their content."""
        return ()

    def artifact_name(self, default: str) -> str:
        """The artifact's name in the store. `default` names its task, or its tasks and its seed."""
        return default


class Kind(NamedTuple):
    """One entry of a registry: import strings `module:attribute` of its settings and of its code."""

    settings: str
    code: str


def imported(name: str) -> Any:
    """The object that the import string `module:attribute` names."""
    module, attribute = name.split(":")
    return getattr(import_module(module), attribute)


def one_of(kinds: Mapping[str, Kind], default: str) -> Any:
    """The union of the settings classes of a registry. The field `kind` selects one of them; without it, `default`."""

    def kind_of(value: Any) -> Any:
        return value.get("kind", default) if isinstance(value, Mapping) else getattr(value, "kind", None)

    members = [Annotated[imported(kind.settings), Tag(name)] for name, kind in kinds.items()]
    return Annotated[Union[tuple(members)], Discriminator(kind_of)]  # noqa: UP007


def values_of(name: str, settings: Any) -> Iterator[Any]:
    """The values of every field `name` in nested settings, as model_dump or JSON gives them."""
    if isinstance(settings, dict):
        for key, value in settings.items():
            if key == name:
                yield value
            yield from values_of(name, value)
    elif isinstance(settings, list | tuple):
        for value in settings:
            yield from values_of(name, value)
