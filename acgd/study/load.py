"""Reads and validates a configuration. Each fault becomes one line: what is wrong, then the mend."""

import difflib
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from types import UnionType
from typing import Annotated, Any, TypeVar, Union, get_args, get_origin

from pydantic import BaseModel, Tag, ValidationError
from pydantic.fields import FieldInfo

Model = TypeVar("Model", bound=BaseModel)


_EXPECTED = {
    "int_parsing": "should be a whole number",
    "int_type": "should be a whole number",
    "int_from_float": "should be a whole number",
    "float_parsing": "should be a number",
    "float_type": "should be a number",
    "bool_parsing": "should be true or false",
    "bool_type": "should be true or false",
    "string_type": "should be a text",
    "tuple_type": "should be a list",
    "list_type": "should be a list",
    "dict_type": "should be a map",
    "model_type": "should be a map of settings",
    "union_tag_not_found": "should be a map of settings",
}
"""Fault type of pydantic -> text in the error message."""


class ConfigError(Exception):
    """The configuration is invalid. The user sees the text unchanged."""


class Content(dict[str, Any]):
    """The map of a configuration file. `lines`: dotted place -> `<file>, line <number>`."""

    def __init__(self, content: Mapping[str, Any], lines: Mapping[str, str]) -> None:
        super().__init__(content)
        self.lines = dict(lines)


def read_yaml(path: Path) -> Content:
    """The map in a configuration file, YAML or JSON. Raises ConfigError of a missing, unreadable or malformed file."""
    from acgd.study.text import content_of

    try:
        content = content_of(path.read_text(encoding="utf-8-sig"), path)
    except FileNotFoundError:
        near = difflib.get_close_matches(path.name, [file.name for file in path.parent.glob("*.yaml")], n=1, cutoff=0.4)
        raise ConfigError(
            f"{path}: no such file." + (f" Nearest: {path.parent / near[0]}." if near else " Give the path of a study.")
        ) from None
    except (UnicodeDecodeError, OSError) as error:
        raise ConfigError(f"{path}: not readable as YAML. {' '.join(str(error).split())}") from None
    if not isinstance(content, Content):
        raise ConfigError(f"{path}: holds {_kind(content)} instead of a map of settings. Start from config.yaml.")
    return content


def read_study(files: Iterable[Path], changes: Iterable[str] = ()) -> Content:
    """The configuration of a run of the workflow: the files, each over the one before, then `changes` (`key=value`)."""
    from acgd.study.text import content_of

    content = Content({}, {})
    for path in files:
        read = read_yaml(path)
        content = Content(merge(content, read), content.lines | read.lines)
    for change in changes:
        name, _, text = change.partition("=")
        content = Content(merge(content, {name.strip(): content_of(text, f"--config {change}")}), content.lines)
    return content


def located(message: str, lines: Mapping[str, str]) -> str:
    """The text of a ConfigError, each fault of a place with the line of that place before it."""
    return "\n".join(_located(fault, lines) for fault in message.splitlines())


def _located(fault: str, lines: Mapping[str, str]) -> str:
    head, *rest = fault.split(": ")
    for place in (f"{head}.{rest[0]}" if rest else head, head):
        if place in lines:
            return f"{lines[place]}: {fault}"
    # A missing key and a variant of `expand` have no line of their own; what is around them has one.
    while head := head[: max(head.rfind("."), head.rfind("["), 0)]:
        if head in lines:
            return f"{lines[head]}: {fault}"
    return fault


def validated(
    model: type[Model], content: Any, prefix: Sequence[str | int] = (), root: type[BaseModel] | None = None
) -> Model:
    """`content` as an instance of `model`. Raises ConfigError with one line for each fault.

    prefix: path of `content` in the configuration. root: model of the whole configuration, where the mend of a
    misplaced key is searched.
    """
    try:
        return model.model_validate(content)
    except ValidationError as error:
        faults = error.errors(include_url=False)
        inner = {fault["loc"][:-1] for fault in faults}
        lines = [_explain(model, root or model, dict(fault), prefix) for fault in faults if not _follows(fault, inner)]
        raise ConfigError("\n".join(dict.fromkeys(lines))) from None


def merge(base: Mapping[str, Any], override: Mapping[str, Any]) -> dict[str, Any]:
    """Merges maps key by key. The override replaces any other value, lists included.

    A section of another kind than the base replaces the base's section, so that it starts from its kind's defaults.
    """
    merged = dict(base)
    for name, value in override.items():
        before = merged.get(name)
        both_maps = isinstance(value, Mapping) and isinstance(before, Mapping)
        if both_maps and "kind" in before and value.get("kind", before["kind"]) != before["kind"]:
            both_maps = False
        merged[name] = merge(before, value) if both_maps else value
    return merged


def nearest(name: str, known: Iterable[str]) -> str | None:
    """The known name that is most similar to `name`, or None."""
    known = list(known)
    for candidate in known:
        if _initials(name, candidate):
            return candidate
    contained = [candidate for candidate in known if len(name) > 2 and (name in candidate or candidate in name)]
    matches = (
        difflib.get_close_matches(name, known, n=1, cutoff=0.6)
        or contained
        or difflib.get_close_matches(name, known, n=1, cutoff=0.4)
    )
    return matches[0] if matches else None


def _initials(name: str, candidate: str) -> bool:
    """Whether `name` has the initials of `candidate`: lr of learning_rate."""
    return "_" in candidate and name == "".join(word[:1] for word in candidate.split("_"))


def dotted(place: Sequence[str | int]) -> str:
    """("student", "lr") -> "student.lr"; ("tasks", 0) -> "tasks[0]"."""
    text = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in place)
    return text.removeprefix(".") or "the configuration"


def _follows(fault: Mapping[str, Any], inner: Iterable[tuple[str | int, ...]]) -> bool:
    """Whether the fault follows from another: pydantic calls a list with an invalid item too short."""
    place = fault["loc"]
    return fault["type"] == "too_short" and any(other[: len(place)] == place for other in inner)


def _explain(model: type[BaseModel], root: type[BaseModel], fault: dict[str, Any], prefix: Sequence[str | int]) -> str:
    """The line for one fault."""
    place, section = _walk(model, fault["loc"])
    where = dotted([*prefix, *place])
    if fault["type"] == "extra_forbidden":
        return f"{where}: unknown key. {_mend_unknown(section, root, place)}"
    field = section.model_fields.get(str(place[-1])) if section and place else None
    if fault["type"] == "missing":
        described = f": {field.description.rstrip('.')}" if field and field.description else ""
        return f"{where}: missing. Add it{described}."
    message, value = fault["msg"].removeprefix("Value error, "), fault.get("input")
    if fault["type"] == "value_error":
        return f"{where}: {message}"
    if fault["type"] == "literal_error":
        return f"{where}: {_mend_choice(value, fault['ctx']['expected'])}"
    if fault["type"] == "union_tag_invalid":
        return f"{where}.kind: {_mend_choice(fault['ctx']['tag'], fault['ctx']['expected_tags'])}"
    expected = _EXPECTED.get(fault["type"]) or _lower(message)
    if fault["type"] == "string_type" and isinstance(value, int | float):
        return f"{where}: {expected}, not {_shown(value)}. Put it in quotes: '{str(value).lower()}'."
    return f"{where}: {expected}, not {_shown(value)}. Correct it, or leave the key out{_default(field)}."


def _mend_choice(value: Any, expected: str) -> str:
    """The message for a value outside the choices. `expected` lists the choices in single quotes."""
    choices = re.findall(r"'([^']*)'", expected)
    near = nearest(str(value), choices)
    return f"{value!r} is none of {', '.join(choices)}." + (f" Nearest: {near}." if near else "")


def _mend_unknown(section: type[BaseModel] | None, root: type[BaseModel], place: Sequence[str | int]) -> str:
    """The mend of an unknown key: another kind, another place, or the nearest known key."""
    name = str(place[-1])
    known = list(section.model_fields) if section else []
    near = nearest(name, known)
    likely = near and (_initials(name, near) or difflib.SequenceMatcher(None, name, near).ratio() >= 0.8)
    paths = list(_places(root))
    if not likely:
        owners = {kind for path, kind in paths if kind and path == (*map(str, place[:-1]), name)}
        if owners:
            return (
                f"It belongs to kind {' or '.join(sorted(owners))}. Set {dotted([*place[:-1], 'kind'])}, or remove it."
            )
        elsewhere = [dotted(path) for path, _ in paths if path[-1] == name]
        if elsewhere:
            return f"Did you mean {elsewhere[0]}? Move it there, or remove it."
    if near:
        return f"Nearest: {near}. Rename it, or remove it."
    return f"Known keys: {', '.join(known)}. Use one of them, or remove it."


def _places(
    model: type[BaseModel], prefix: tuple[str, ...] = (), kind: str = ""
) -> Iterable[tuple[tuple[str, ...], str]]:
    """(path, kind) of every key. The kind is empty in a section without kinds."""
    for name, field in model.model_fields.items():
        yield (*prefix, name), kind
        for tag, inner in members(field.annotation).items():
            yield from _places(inner, (*prefix, name), tag)


def _walk(model: type[BaseModel], place: Sequence[str | int]) -> tuple[list[str | int], type[BaseModel] | None]:
    """The place without the parts that pydantic adds, such as a section's kind; and the section with its last key."""
    current: Any = model
    section: type[BaseModel] | None = None
    plain: list[str | int] = []
    for part in place:
        kinds = members(current)
        if part in kinds and part != "":
            current = kinds[str(part)]
            continue
        if isinstance(part, str) and "[" in part:
            continue
        plain.append(part)
        section = kinds.get("") if kinds else None
        if section is not None and part in section.model_fields:
            current = section.model_fields[part].annotation
        else:
            arguments = [argument for argument in get_args(current) if argument is not Ellipsis]
            current = arguments[-1] if arguments else None
    return plain, section


def members(annotation: Any) -> dict[str, type[BaseModel]]:
    """The sections that a field can hold: kind -> section, or "" -> section without kinds; empty for other fields."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return {"": annotation}
    if get_origin(annotation) is Annotated:
        tags = [mark.tag for mark in annotation.__metadata__ if isinstance(mark, Tag)]
        inner = members(get_args(annotation)[0])
        return {tags[0]: inner[""]} if tags else inner
    if get_origin(annotation) in (Union, UnionType):
        return {tag: section for argument in get_args(annotation) for tag, section in members(argument).items()}
    return {}


def _default(field: FieldInfo | None) -> str:
    if field is None or field.is_required() or field.default_factory or isinstance(field.default, BaseModel):
        return ""
    return f" for its default, {field.default!r}"


def _kind(value: Any) -> str:
    return {type(None): "nothing", list: "a list", str: "a text"}.get(type(value), f"a {type(value).__name__}")


def _shown(value: Any) -> str:
    return _kind(value) if isinstance(value, dict | list) or value is None else repr(value)


def _lower(message: str) -> str:
    return message[:1].lower() + message[1:].rstrip(".")
