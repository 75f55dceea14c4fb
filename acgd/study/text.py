"""The text of a configuration file: YAML as people write it, with the line of every key.

The words of YAML 1.2 hold: only `true` and `false` are truth values, so that `off`, `no` and `on` are words. A number
may have an exponent without a point (1e-3). A key is a text as it is written, so that `10` and `no` can name a variant.
"""

import re
from collections.abc import Hashable
from pathlib import Path
from typing import Any

import yaml

from acgd.study.load import ConfigError, Content, dotted

Place = tuple[str | int, ...]

_WORDS = re.compile(r"true|True|TRUE|false|False|FALSE")
_NOTHING = re.compile(r"~|null|Null|NULL|")
_INTEGER = re.compile(r"[-+]?[0-9][0-9_]*|0o[0-7]+|0x[0-9a-fA-F]+")
_FLOAT = re.compile(r"[-+]?(\.[0-9]+|[0-9][0-9_]*(\.[0-9_]*)?)([eE][-+]?[0-9]+)?")
_NO_NUMBER = re.compile(r"[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)")


class _Loader(yaml.SafeLoader):
    """Splits the text into nodes. Every plain scalar stays a text; `_plain` gives it its value."""

    yaml_implicit_resolvers = {"<": [("tag:yaml.org,2002:merge", re.compile("<<"))]}


def content_of(text: str, source: Path | str) -> Any:
    """The content of a YAML text; a map as Content. Raises ConfigError of a malformed text, with the line."""
    try:
        node = yaml.compose(text, Loader=_Loader)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        where = f"{source}, line {mark.line + 1}" if mark else str(source)
        context = f" {error.context}" if error.context else ""
        mend = (
            "Indent with spaces." if "'\\t'" in str(error.problem) else "Put a text with special characters in quotes."
        )
        raise ConfigError(f"{where}: not readable as YAML: {error.problem}{context}. {mend}") from None
    except yaml.YAMLError as error:
        raise ConfigError(f"{source}: not readable as YAML. {' '.join(str(error).split())}") from None
    if node is None:
        return None
    reader = _Reader(source)
    value = reader.value(node, (), ())
    return Content(value, reader.lines) if isinstance(value, dict) else value


class _Reader:
    def __init__(self, source: Path | str) -> None:
        self.source = source
        self.lines: dict[str, str] = {}
        """Dotted place -> `<file>, line <number>`."""

    def value(self, node: yaml.Node, place: Place, parents: tuple[yaml.Node, ...]) -> Any:
        """The value of a node. `parents`: the nodes around it."""
        self.lines.setdefault(dotted(place), self.line(node))
        if node in parents:
            raise ConfigError(f"{self.line(node)}: {dotted(place)} contains itself. Remove the alias (*name).")
        around = (*parents, node)
        if isinstance(node, yaml.MappingNode):
            return self.map(node, place, around)
        if isinstance(node, yaml.SequenceNode):
            return [self.value(item, (*place, index), around) for index, item in enumerate(node.value)]
        if node.tag not in ("tag:yaml.org,2002:str", "tag:yaml.org,2002:merge"):
            raise ConfigError(f"{self.line(node)}: the tag {node.tag} has no meaning here. Remove it.")
        return node.value if node.style else _plain(node.value)

    def map(self, node: yaml.MappingNode, place: Place, around: tuple[yaml.Node, ...]) -> dict[str, Any]:
        """The map of a node. A key of the map itself replaces a merged one (`<<: *name`)."""
        first: dict[Hashable, yaml.Node] = {}
        merged: dict[str, Any] = {}
        direct: dict[str, Any] = {}
        for key, item in node.value:
            if not isinstance(key, yaml.ScalarNode):
                raise ConfigError(f"{self.line(key)}: a key must be a text. Write `name: value`.")
            name = key.value
            where = (*place, name)
            if name in first:
                before = first[name].start_mark.line + 1
                raise ConfigError(
                    f"{self.line(key)}: {dotted(where)} is there twice, first in line {before}. "
                    "Merge the two, or remove one."
                )
            first[name] = key
            if key.tag == "tag:yaml.org,2002:merge":
                inherited = self.value(item, place, around)
                for one in reversed(inherited if isinstance(inherited, list) else [inherited]):
                    if not isinstance(one, dict):
                        raise ConfigError(f"{self.line(key)}: << needs a map. Write <<: *name of a map.")
                    merged |= one
            else:
                self.lines[dotted(where)] = self.line(key)
                direct[name] = self.value(item, where, around)
        return {**merged, **direct}

    def line(self, node: yaml.Node) -> str:
        return f"{self.source}, line {node.start_mark.line + 1}"


def _plain(text: str) -> Any:
    """The value of a scalar without quotes. A number with underscores or leading zeros is decimal."""
    if _WORDS.fullmatch(text):
        return text.lower() == "true"
    if _NOTHING.fullmatch(text):
        return None
    if _INTEGER.fullmatch(text):
        return int(text, 0 if text[:2] in ("0o", "0x") else 10)
    if _FLOAT.fullmatch(text):
        return float(text)
    if _NO_NUMBER.fullmatch(text):
        return float(text.replace(".", ""))
    return text
