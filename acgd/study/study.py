"""A study: tasks, settings of every stage, student seeds, and variants to compare."""

import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import make_dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Literal, TypeVar

from pydantic import BaseModel, Field, JsonValue, create_model, field_validator, model_validator
from pydantic.fields import FieldInfo

from acgd import chain
from acgd.evaluation.settings import Condition
from acgd.experts import zoo
from acgd.reports.settings import ReportConfig
from acgd.settings import OUTSIDE_KEY, Section, imported
from acgd.students.settings import RoundsConfig
from acgd.study.load import ConfigError, dotted, located, merge, nearest, validated
from acgd.study.variants import expanded
from acgd.tasks.settings import TaskConfig
from acgd.tasks.spec import GOAL_SIZES, TASKS

Item = TypeVar("Item")

NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]*")
RESERVED_STUDIES = ("store", "work", "logs", "benchmarks", "mlruns")
"""Folders of results/ that belong to no study."""
RESERVED_VARIANTS = ("report", "mlflow")
FILES_OF_RESULTS = (".html", ".csv", ".svg", ".db", ".lock", ".draft")
"""Endings of files beside the folders of studies and variants."""
LONGEST_NAME = 120
"""Characters of a name: file systems have 255, and a name gets endings."""
PER_TASK = ("task", "expert", "critic", "rollouts")
"""Sections that `overrides` may change for one task."""

TaskDefaults = create_model(
    "TaskDefaults",
    __base__=Section,
    __doc__="All fields of a task except its name.",
    **{name: (field.annotation, field) for name, field in TaskConfig.model_fields.items() if name != "name"},
)

TaskOverrides = create_model(
    "TaskOverrides",
    __base__=Section,
    __doc__="Settings of one task that differ from those of the study.",
    **{name: (dict[str, JsonValue], Field({}, description=f"Keys of `{name}`.")) for name in PER_TASK},
)

TaskSettings = make_dataclass("TaskSettings", PER_TASK, frozen=True)
"""The sections of PER_TASK for one task."""


class _Axes(Section):
    """The axes of the artifacts, and the settings of single tasks."""

    tasks: tuple[str, ...] = Field(
        ("myo/key-turn", "myo/obj-hold", "myo/reach"),
        min_length=1,
        description="Tasks that one student learns together. Their order gives the task ids.",
    )
    seeds: tuple[int, ...] = Field(
        (0, 1, 2),
        min_length=1,
        description="Student seeds. A seed determines codebook, data order and initialisation.",
    )
    conditions: tuple[Condition, ...] = Field(
        (Condition(),),
        min_length=1,
        description="Conditions of the evaluation, one artifact each. The first one is the headline.",
    )
    rounds: RoundsConfig = Field(RoundsConfig(), description="More rollouts after the demonstrations.")
    task: TaskDefaults = Field(TaskDefaults(), description="Settings of every task. `overrides` has exceptions.")
    overrides: dict[str, TaskOverrides] = Field({}, description="Task name -> settings of that task that differ.")


AXIS_FIELDS = ("task", "tasks", "seed", "round", "rounds", "condition")
"""Fields of a request that the plan fills from the axes. They are no sections of a study."""


def _sections() -> dict[str, tuple[Any, FieldInfo]]:
    """The sections of a study: the fields of the stages' requests.

    If several requests have a field, the request of the stage with the field's name declares it; else the first one.
    """
    requests = {name: imported(stage.request) for name, stage in chain.STAGES.items()}
    sections: dict[str, tuple[Any, FieldInfo]] = {}
    for stage, request in requests.items():
        for name, field in request.model_fields.items():
            if name not in AXIS_FIELDS and (name not in sections or name == stage):
                sections[name] = (field.annotation, field)
    return sections


class _Checks(_Axes):
    """Checks across the sections of a variant."""

    @field_validator("tasks")
    @classmethod
    def _known_tasks(cls, tasks: tuple[str, ...]) -> tuple[str, ...]:
        for name in tasks:
            if name not in TASKS:
                near = nearest(name, TASKS) or next(iter(TASKS))
                raise ValueError(f"{name!r} is no task. Nearest: {near}. Known: {', '.join(TASKS)}.")
        first = TASKS[tasks[0]].suite
        if other := [name for name in tasks if TASKS[name].suite != first]:
            raise ValueError(
                f"{tasks[0]} and {other[0]} belong to suites with different robots. A student has the actions and the "
                "proprioception of one suite. Write a study for each suite."
            )
        return _distinct(tasks)

    @field_validator("seeds")
    @classmethod
    def _usable_seeds(cls, seeds: tuple[int, ...]) -> tuple[int, ...]:
        if min(seeds) < 0:
            raise ValueError(f"{min(seeds)} is negative. Use seeds from 0 on.")
        return _distinct(seeds)

    @model_validator(mode="after")
    def _overrides_of_its_tasks(self) -> "_Checks":
        for name in self.overrides:
            if name not in self.tasks:
                near = nearest(name, self.tasks) or self.tasks[0]
                raise ValueError(f"overrides.{name}: {name} is not in tasks. Nearest: {near}.")
        return self

    @cached_property
    def each_task(self) -> tuple[TaskSettings, ...]:
        """The sections of PER_TASK for each task, in the order of the tasks."""
        return tuple(self._settings_of(name) for name in self.tasks)

    def _settings_of(self, task: str) -> TaskSettings:
        override = self.overrides.get(task, TaskOverrides())
        return TaskSettings(**{name: self._overridden(name, task, getattr(override, name)) for name in PER_TASK})

    def _overridden(self, section: str, task: str, override: Mapping[str, Any]) -> Any:
        """A section merged with a task's override and validated."""
        base = _explicit(getattr(self, section))
        if section == "task":
            return validated(TaskConfig, {**base, **override, "name": task}, ("overrides", task, section))
        if not override:
            return getattr(self, section)
        content = {section: merge({section: base}, {section: override})[section]}
        model = create_model("Overridden", __base__=Section, **{section: _sections()[section]})
        return getattr(validated(model, content, ("overrides", task)), section)


Settings = create_model("Settings", __base__=_Checks, __doc__="All settings of one variant.", **_sections())


class Study(Settings):
    """The whole configuration."""

    name: str = Field("laptop", description="Folder in results/, experiment in MLflow.")
    variants: dict[str, dict[str, JsonValue]] = Field(
        {},
        description="Name -> overrides of any section. {expand: [a, b]} in place of a value gives one variant for each "
        "value. Without variants the study has one, `base`, which overrides nothing.",
    )
    report: ReportConfig = Field(ReportConfig(), description="Stage report, one artifact.")
    device: Literal["auto", "cpu", "cuda"] = Field(
        "auto",
        description="Device of the networks. auto: the GPU if torch sees one, else the CPU.",
        json_schema_extra=OUTSIDE_KEY,
    )

    @field_validator("name")
    @classmethod
    def _usable_name(cls, name: str) -> str:
        return _path_part(name, RESERVED_STUDIES)

    @field_validator("variants")
    @classmethod
    def _usable_variants(cls, variants: dict[str, dict[str, JsonValue]]) -> dict[str, dict[str, JsonValue]]:
        folders: dict[str, str] = {}
        for name in expanded(variants):
            _path_part(name, RESERVED_VARIANTS)
            other = folders.setdefault(name.lower(), name)
            if other != name:
                raise ValueError(f"{other!r} and {name!r} are one folder on some disks. Rename one of them.")
        return variants

    @cached_property
    def resolved(self) -> dict[str, Settings]:
        """Variant -> settings: the base with the variant's overrides."""
        base = {name: _explicit(getattr(self, name)) for name in self.model_fields_set & set(Settings.model_fields)}
        overrides = expanded(self.variants) or {"base": {}}
        return {name: self._variant(name, base, override) for name, override in overrides.items()}

    def _variant(self, name: str, base: dict[str, Any], override: dict[str, Any]) -> Settings:
        place = ("variants", name)
        if "tasks" in override:
            where = dotted((*place, "tasks"))
            raise ConfigError(
                f"{where}: the variants of a study share their tasks. Write another study for other tasks."
            )
        settings = validated(Settings, merge(base, override), place, root=Study)
        with _named(place):
            _ = settings.each_task  # validates the overrides of the tasks
        return settings


def load_study(content: Mapping[str, Any]) -> Study:
    """Validates a configuration with all its variants, tasks and files.

    Raises ConfigError with one line for each fault and its mend; with the line in the file where `content` is Content.
    """
    try:
        return _loaded(content)
    except ConfigError as error:
        raise ConfigError(located(str(error), getattr(content, "lines", {}))) from None


def _loaded(content: Mapping[str, Any]) -> Study:
    if huge := list(_beyond_64_bits(content)):
        raise ConfigError("\n".join(huge))
    study = validated(Study, _at_home(content))
    faults = list(_faults(study))
    for name, settings in study.resolved.items():
        faults += [f"variants.{name}: {fault}" for fault in _faults(settings) if fault not in faults]
    if study.report.baseline is not None and study.report.baseline not in study.resolved:
        near = nearest(study.report.baseline, study.resolved) or next(iter(study.resolved))
        faults.append(f"report.baseline: {study.report.baseline!r} is no variant. Nearest: {near}.")
    if faults:
        raise ConfigError("\n".join(faults))
    return study


def _items(value: Any) -> Iterator[tuple[str | int, Any]]:
    return iter(value.items() if isinstance(value, Mapping) else enumerate(value) if isinstance(value, list) else ())


def _beyond_64_bits(value: Any, place: tuple[str | int, ...] = ()) -> Iterator[str]:
    """A fault for each whole number that no file format of the store holds."""
    if isinstance(value, int) and not -(2**63) <= value < 2**63:
        yield f"{dotted(place)}: {value} has more than 64 bits. Use a smaller number."
    for name, item in _items(value):
        yield from _beyond_64_bits(item, (*place, name))


def _at_home(value: Any) -> Any:
    """The content with `~/` at the start of a text replaced by the home folder: such a text is a path."""
    if isinstance(value, Mapping):
        return {name: _at_home(item) for name, item in value.items()}
    if isinstance(value, list):
        return [_at_home(item) for item in value]
    return str(Path(value).expanduser()) if isinstance(value, str) and value.startswith("~/") else value


def _explicit(value: Any) -> Any:
    """The keys that the configuration sets in a section, and the section's kind, which `merge` needs."""
    if isinstance(value, BaseModel):
        content = {name: _explicit(getattr(value, name)) for name in value.model_fields_set}
        return content | ({"kind": value.kind} if "kind" in type(value).model_fields else {})
    if isinstance(value, Mapping):
        return {name: _explicit(item) for name, item in value.items()}
    if isinstance(value, list | tuple):
        return [_explicit(item) for item in value]
    return value


def _faults(settings: Settings) -> Iterator[str]:
    """Messages for missing files, excitation without muscles, and missing zoo experts and critics."""
    if TASKS[settings.tasks[0]].suite != "myo":
        spaces = {"imitation": {settings.imitation.action_space}}
        for section in ("critic", "expert"):
            spaces[section] = {getattr(getattr(task, section), "action_space", "raw") for task in settings.each_task}
        for section in sorted(name for name, values in spaces.items() if "excitation" in values):
            yield (
                f"{section}.action_space: excitation needs muscles, and {settings.tasks[0]} has motors. Set it to raw."
            )
    goal, frames = settings.imitation.goal, settings.imitation.frames
    if frames > 1 and not settings.backbone.gives_features:
        yield (
            f"imitation.frames: it is {frames}, and with backbone.kind {settings.backbone.kind} a student reads one "
            "image. Set it to 1, or take another backbone."
        )
    if goal == "vector" and not any(TASKS[name].kind in GOAL_SIZES for name in settings.tasks):
        yield "imitation.goal: no task of the study has a commanded goal that varies. Set it to any, own or off."
    if goal in ("own", "any"):
        for condition in settings.conditions:
            if condition.goal in ("commanded", "none"):
                yield (
                    f"conditions: goal {condition.goal} is not for a student of imitation.goal: {goal}, which reads "
                    "goal images. Set it to training or oracle."
                )
    for place, path in _paths(settings):
        if not path.exists():
            yield (
                f"{dotted(place)}: {path} does not exist. Give the path of an existing file, relative to the folder of "
                "config.yaml."
            )
    yield from zoo.faults([(task.task.name, task.expert, task.critic) for task in settings.each_task])


def _paths(section: BaseModel, place: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], Path]]:
    """(place in the configuration, path) of every path in a section."""
    for name in type(section).model_fields:
        value = getattr(section, name)
        if isinstance(value, BaseModel):
            yield from _paths(value, (*place, name))
        elif isinstance(value, Path):
            yield (*place, name), value


@contextmanager
def _named(place: tuple[str, ...]) -> Iterator[None]:
    """Prefixes a ConfigError with the variant's name."""
    try:
        yield
    except ConfigError as error:
        raise ConfigError(f"{dotted(place)}: {error}") from None


def _distinct(items: tuple[Item, ...]) -> tuple[Item, ...]:
    twice = [item for item in dict.fromkeys(items) if items.count(item) > 1]
    if twice:
        raise ValueError(f"{twice[0]!r} is listed twice. List it once.")
    return items


def _path_part(name: str, reserved: tuple[str, ...]) -> str:
    if not NAME.fullmatch(name) or name in reserved:
        raise ValueError(
            f"{name!r} cannot name a folder. Use letters, digits, '.', '_' and '-', and none of {', '.join(reserved)}."
        )
    if name.endswith(FILES_OF_RESULTS):
        raise ValueError(f"{name!r} may be the name of a file in results/. Leave out the ending {Path(name).suffix}.")
    if len(name) > LONGEST_NAME:
        raise ValueError(f"{name!r} has {len(name)} characters. Use at most {LONGEST_NAME}.")
    return name
