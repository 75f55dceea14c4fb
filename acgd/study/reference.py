"""Writes the reference of the configuration from the models: docs/configuration.md and docs/schema.json."""

import json
import types
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo
from pydantic_core import PydanticUndefined, to_jsonable_python

from acgd.study.load import members
from acgd.study.study import Study

HEAD = """# Configuration

`python -m acgd schema` writes this page from the settings in `acgd/*/settings.py`; a test notices when the two differ.
[schema.json](schema.json) holds the same settings for editors: `# yaml-language-server: $schema=docs/schema.json`.

`config.yaml` is the default study. `studies/*.yaml` are others:
`snakemake --cores 2 all --configfile studies/<study>.yaml`.
A key that is left out has its default. Unknown keys are refused.
`python -m acgd check` validates every study and runs nothing.

**Kinds.** `expert`, `critic`, `backbone`, `student` and `guidance` have kinds. Each kind has settings of its own.

**Variants.** `variants:` maps a name to overrides of any section. Maps are merged, lists are replaced.
An override that names another kind starts from that kind's defaults.
`{expand: [a, b]}` in place of a value gives one variant for each value, named `<variant>-<key>-<value>`:

```yaml
variants:
  acgd: {guidance: {kind: critic}}
  no-guidance: {guidance: {kind: none}}
  bc: {student: {kind: bc}, guidance: {kind: none}}
  demos: {rollouts: {demonstrations: {expand: [10, 30, 100]}}}   # demos-demonstrations-10, ...
```

**Exceptions for one task.** `overrides: {myo/reach: {expert: {kind: ppo}}}`.
The sections `task`, `expert`, `critic` and `rollouts` accept overrides.

**What reruns.** The key of an artifact hashes the settings of its stage, the keys of its inputs, and the sources that
define its tasks. Fields marked † are not hashed: they change how an artifact is made, not its content.
"""


def write(docs: Path) -> None:
    """Writes configuration.md and schema.json into the folder `docs`."""
    docs.mkdir(parents=True, exist_ok=True)
    (docs / "configuration.md").write_text(markdown(), encoding="utf-8")
    (docs / "schema.json").write_text(schema(), encoding="utf-8")


def schema() -> str:
    """JSON schema of a study."""
    return json.dumps(Study.model_json_schema(), indent=1, sort_keys=True, ensure_ascii=False) + "\n"


def markdown() -> str:
    """The page: a table for the study, and one for each section or each kind of a section."""
    parts = [HEAD]
    plain = [(name, field) for name, field in Study.model_fields.items() if not members(field.annotation)]
    parts.append(_table("The study", "", plain))
    for name, field in Study.model_fields.items():
        kinds = members(field.annotation)
        if set(kinds) == {""}:
            parts.append(
                _table(f"`{name}`", f"{field.description} {_first_paragraph(kinds[''])}", list(_leaves(kinds[""])))
            )
        elif kinds:
            default = field.get_default(call_default_factory=True).kind
            parts.append(f"## `{name}`\n\n{field.description} Without `kind` it is `{default}`.\n")
            for kind, model in kinds.items():
                title = f"`{name}: {{kind: {kind}}}`"
                parts.append(
                    _table(
                        title, _first_paragraph(model), [row for row in _leaves(model) if row[0] != "kind"], level="###"
                    )
                )
    return "\n".join(parts)


def _leaves(model: type[BaseModel], prefix: str = "") -> Iterator[tuple[str, FieldInfo]]:
    """(dotted name, field) of a section, with the fields of nested sections."""
    for name, field in model.model_fields.items():
        inner = members(field.annotation)
        if set(inner) == {""}:
            yield from _leaves(inner[""], f"{prefix}{name}.")
        else:
            yield f"{prefix}{name}", field


def _table(title: str, text: str, rows: list[tuple[str, FieldInfo]], level: str = "##") -> str:
    lines = [
        f"{level} {title}",
        "",
        *([text.strip(), ""] if text.strip() else []),
        *(["| key | type | default | |", "|---|---|---|---|"] if rows else ["No settings."]),
    ]
    for name, field in rows:
        mark = " †" if isinstance(field.json_schema_extra, dict) and field.json_schema_extra.get("key") is False else ""
        cells = (f"`{name}`{mark}", _type(field.annotation), _default(field), field.description or "")
        lines.append("| " + " | ".join(cell.replace("|", "\\|").replace("\n", " ") for cell in cells) + " |")
    return "\n".join(lines) + "\n"


def _type(annotation: Any) -> str:
    origin, arguments = get_origin(annotation), get_args(annotation)
    if origin is Annotated:
        return _type(arguments[0])
    if origin is Literal:
        return ", ".join(f"`{choice}`" for choice in arguments)
    if origin in (Union, types.UnionType):
        return " or ".join("nothing" if argument is types.NoneType else _type(argument) for argument in arguments)
    if origin in (tuple, list):
        return f"list of {_type(arguments[0])}"
    if origin is dict:
        return "map"
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return "map of " + ", ".join(f"`{name}`" for name in annotation.model_fields)
    names = {int: "whole number", float: "number", bool: "true, false", str: "text", Path: "path"}
    return names.get(annotation, str(annotation))


def _default(field: FieldInfo) -> str:
    default = field.get_default(call_default_factory=True)
    if default is PydanticUndefined:
        return "required"
    if default is None:
        return ""
    return f"`{json.dumps(to_jsonable_python(default), ensure_ascii=False)}`"


def _first_paragraph(model: type[BaseModel]) -> str:
    return " ".join((model.__doc__ or "").split("\n\n")[0].split())
