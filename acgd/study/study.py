"""A study: tasks, settings of every stage, student seeds, and the variants that are compared."""

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Literal, TypeVar

from pydantic import BaseModel, Field, JsonValue, create_model, field_validator, model_validator

from acgd.collection.settings import RolloutsConfig
from acgd.critics.settings import CriticConfig
from acgd.evaluation.settings import ControlsConfig, EvaluationConfig
from acgd.experts import zoo
from acgd.experts.settings import ExpertSettings
from acgd.reports.settings import ReportConfig
from acgd.settings import Section
from acgd.students.settings import CodebookConfig, StudentConfig
from acgd.study.load import ConfigError, dotted, merge, nearest, validated
from acgd.study.variants import expanded
from acgd.tasks.settings import TaskConfig
from acgd.tasks.spec import TASKS
from acgd.vision.settings import BackboneConfig, FeaturesConfig

Model = TypeVar("Model", bound=BaseModel)
Item = TypeVar("Item")

NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]*")
RESERVED_STUDIES = ("store", "work", "logs", "benchmarks", "mlruns")
"""Folders of results/ that are no study."""
RESERVED_VARIANTS = ("report", "mlflow")

TaskDefaults = create_model(
    "TaskDefaults",
    __base__=Section,
    __doc__="What holds for every task: the fields of a task but its name.",
    **{name: (field.annotation, field) for name, field in TaskConfig.model_fields.items() if name != "name"},
)


class TaskOverrides(Section):
    """What one task does otherwise."""

    task: dict[str, JsonValue] = Field({}, description="Keys of `task`.")
    expert: dict[str, JsonValue] = Field({}, description="Keys of `expert`.")
    critic: dict[str, JsonValue] = Field({}, description="Keys of `critic`.")
    rollouts: dict[str, JsonValue] = Field({}, description="Keys of `rollouts`.")


@dataclass(frozen=True)
class TaskSettings:
    """The settings of the stages that run once for each task."""

    task: TaskConfig
    expert: ExpertSettings
    critic: CriticConfig
    rollouts: RolloutsConfig


class Settings(Section):
    """All that one variant is made from."""

    tasks: tuple[str, ...] = Field(
        ("myo/key-turn", "myo/obj-hold", "myo/reach"),
        min_length=1,
        description="Tasks that one student learns together. Their order gives the task ids.",
    )
    seeds: tuple[int, ...] = Field(
        (0, 1, 2), min_length=1, description="Student seeds. Each reseeds codebook, data order and initialisation."
    )
    task: TaskDefaults = Field(TaskDefaults(), description="The same for every task; `overrides` has exceptions.")
    expert: ExpertSettings = Field(ExpertSettings(), description="Stage expert, one artifact for each task.")
    critic: CriticConfig = Field(CriticConfig(), description="Stage critic, one artifact for each task.")
    rollouts: RolloutsConfig = Field(RolloutsConfig(), description="Stage rollouts, one artifact for each task.")
    backbone: BackboneConfig = Field(BackboneConfig(), description="Stage backbone.")
    features: FeaturesConfig = Field(FeaturesConfig(), description="Stage features, one artifact for each task.")
    codebook: CodebookConfig = Field(
        CodebookConfig(), description="Stage codebook, one artifact for each student seed."
    )
    student: StudentConfig = Field(StudentConfig(), description="Stage student, one artifact for each student seed.")
    evaluation: EvaluationConfig = Field(
        EvaluationConfig(), description="Stage evaluation, one artifact for each student."
    )
    controls: ControlsConfig = Field(ControlsConfig(), description="Stage controls, one artifact.")
    overrides: dict[str, TaskOverrides] = Field({}, description="Task name -> what that task does otherwise.")

    @field_validator("tasks")
    @classmethod
    def _known_tasks(cls, tasks: tuple[str, ...]) -> tuple[str, ...]:
        for name in tasks:
            if name not in TASKS:
                raise ValueError(
                    f"{name!r} is no task. Nearest: {nearest(name, TASKS) or next(iter(TASKS))}. Known: {', '.join(TASKS)}."
                )
        first = TASKS[tasks[0]].suite
        if other := [name for name in tasks if TASKS[name].suite != first]:
            raise ValueError(
                f"{tasks[0]} and {other[0]} have different robots, and a student has one: its actions and proprioception are those of one suite. "
                "Write a study for each suite."
            )
        return _distinct(tasks)

    @field_validator("seeds")
    @classmethod
    def _usable_seeds(cls, seeds: tuple[int, ...]) -> tuple[int, ...]:
        if min(seeds) < 0:
            raise ValueError(f"{min(seeds)} is negative; seeds count from 0.")
        return _distinct(seeds)

    @model_validator(mode="after")
    def _overrides_of_its_tasks(self) -> "Settings":
        for name in self.overrides:
            if name not in self.tasks:
                raise ValueError(
                    f"overrides.{name} is for a task that is not in tasks. Nearest: {nearest(name, self.tasks) or self.tasks[0]}."
                )
        return self

    @cached_property
    def each_task(self) -> tuple[TaskSettings, ...]:
        """What the stages that run once for each task are asked for, in the order of the tasks."""
        return tuple(self._of(name) for name in self.tasks)

    def _of(self, name: str) -> TaskSettings:
        override = self.overrides.get(name, TaskOverrides())
        return TaskSettings(
            task=self._merged(TaskConfig, "task", name, override.task, {"name": name}),
            expert=self._merged(ExpertSettings, "expert", name, override.expert),
            critic=self._merged(CriticConfig, "critic", name, override.critic),
            rollouts=self._merged(RolloutsConfig, "rollouts", name, override.rollouts),
        )

    def _merged(
        self,
        model: type[Model],
        section: str,
        task: str,
        override: Mapping[str, Any],
        given: Mapping[str, Any] | None = None,
    ) -> Model:
        content = merge(getattr(self, section).model_dump(exclude_unset=True), override)
        return validated(model, {**content, **(given or {})}, ("overrides", task, section))


class Study(Settings):
    """The whole configuration."""

    name: str = Field("laptop", description="Folder in results/, experiment in MLflow.")
    variants: dict[str, dict[str, JsonValue]] = Field(
        {},
        description="Name -> overrides of any section above. {expand: [a, b]} in place of a value gives one variant for each value. "
        "Without variants there is one, `base`, which overrides nothing.",
    )
    report: ReportConfig = Field(ReportConfig(), description="Stage report, one artifact.")
    device: Literal["auto", "cpu", "cuda"] = Field(
        "auto", description="Where networks run. auto: the GPU, if torch sees one.", json_schema_extra={"key": False}
    )

    @field_validator("name")
    @classmethod
    def _usable_name(cls, name: str) -> str:
        return _path_part(name, RESERVED_STUDIES)

    @field_validator("variants")
    @classmethod
    def _usable_variants(cls, variants: dict[str, dict[str, JsonValue]]) -> dict[str, dict[str, JsonValue]]:
        for name in expanded(variants):
            _path_part(name, RESERVED_VARIANTS)
        return variants

    @cached_property
    def resolved(self) -> dict[str, Settings]:
        """Every variant, expanded and merged into the base."""
        base = self.model_dump(exclude_unset=True, exclude=set(Study.model_fields) - set(Settings.model_fields))
        return {
            name: self._variant(name, base, override)
            for name, override in (expanded(self.variants) or {"base": {}}).items()
        }

    def _variant(self, name: str, base: dict[str, Any], override: dict[str, Any]) -> Settings:
        place = ("variants", name)
        if "tasks" in override:
            raise ConfigError(
                f"{dotted((*place, 'tasks'))}: the variants of a study share their tasks. Write a study of its own for other tasks."
            )
        settings = validated(Settings, merge(base, override), place, root=Study)
        with _inside(place):
            settings.each_task
        return settings


def load_study(content: Mapping[str, Any]) -> Study:
    """The study in a configuration, with every variant, task and file checked; a ConfigError names each fault and its mend."""
    study = validated(Study, dict(content))
    faults = list(_faults(study))
    for name, settings in study.resolved.items():
        with_prefix = (f"variants.{name}: {fault}" for fault in _faults(settings) if fault not in faults)
        faults.extend(list(with_prefix))
    if study.report.baseline is not None and study.report.baseline not in study.resolved:
        near = nearest(study.report.baseline, study.resolved) or next(iter(study.resolved))
        faults.append(f"report.baseline: {study.report.baseline!r} is no variant. Nearest: {near}.")
    if faults:
        raise ConfigError("\n".join(faults))
    return study


def _faults(settings: Settings) -> Iterator[str]:
    """Files that the settings name and that are not there; muscles that a robot does not have."""
    if TASKS[settings.tasks[0]].suite != "myo":
        spaces = {"codebook": {settings.codebook.action_space}}
        spaces["critic"] = {each.critic.action_space for each in settings.each_task}
        spaces["expert.sac"] = {each.expert.sac.action_space for each in settings.each_task}
        for section in sorted(name for name, found in spaces.items() if "excitation" in found):
            yield f"{section}.action_space: {settings.tasks[0]} is moved by motors, and excitation is of muscles. Set it to raw."
    for place, path in _paths(settings):
        if not path.exists():
            yield f"{dotted(place)}: {path} does not exist. Give the path of a file that does; it counts from the folder of config.yaml."
    yield from _zoo_faults(settings.each_task)


def _zoo_faults(tasks: Sequence[TaskSettings]) -> Iterator[str]:
    """Experts and critics that are asked for where there are none."""

    def asked(where: Callable[[TaskSettings], bool]) -> list[str]:
        return [each.task.name for each in tasks if where(each)]

    def sources(critic: str, expert: str) -> Callable[[TaskSettings], bool]:
        return lambda each: (each.critic.source, each.expert.source) == (critic, expert)

    first = [each.expert for each in tasks if each.expert.source == "train" and each.expert.first_task]
    wanted = (
        (asked(lambda each: each.expert.source == "zoo"), zoo.has_expert,
         "expert.source: zoo/ has no expert for {}. Set expert.source: train, or take tasks that it has: {}."),
        ([expert.first_task for expert in first], zoo.has_expert,
         "expert.warm_start: zoo/ has no expert for {}. Leave it empty, or take one that it has: {}."),
        ([expert.first_task for expert in first if expert.algorithm == "sac"], zoo.has_own_critics,
         "expert.warm_start: the expert in zoo/ for {} has no critics for SAC to go on with. Leave it empty, or take: {}."),
        (asked(sources("zoo", "zoo")), zoo.has_fitted_critic,
         "critic.source: zoo/ has no critic for {}. Set critic.source: fqe, or take tasks whose critics it has: {}."),
        (asked(sources("expert", "zoo")), zoo.has_own_critics,
         "critic.source: the expert in zoo/ for {} has no critics of its own, only off-policy ones have. Set critic.source: fqe, or take: {}."),
    )  # fmt: skip
    for names, there, fault in wanted:
        if absent := [name for name in dict.fromkeys(names) if not there(name)]:
            yield fault.format(", ".join(absent), ", ".join(filter(there, TASKS)) or "none yet")
    if anew := asked(sources("zoo", "train")):
        yield f"critic.source: the critics in zoo/ judge the experts there, and {', '.join(anew)} trains one. Set critic.source: fqe, or expert.source: zoo."
    if on_policy := asked(lambda each: sources("expert", "train")(each) and each.expert.algorithm != "sac"):
        yield f"critic.source: the expert of {', '.join(on_policy)} will have no critics of its own. Set critic.source: fqe, or expert.algorithm: sac."


def _paths(section: BaseModel, place: tuple[str, ...] = ()) -> Iterator[tuple[tuple[str, ...], Path]]:
    for name in type(section).model_fields:
        value = getattr(section, name)
        if isinstance(value, BaseModel):
            yield from _paths(value, (*place, name))
        elif isinstance(value, Path):
            yield (*place, name), value


class _inside:
    """Puts a variant's name before the faults found in it."""

    def __init__(self, place: tuple[str, ...]) -> None:
        self.place = place

    def __enter__(self) -> None:
        return None

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        if isinstance(error, ConfigError):
            raise ConfigError(f"{dotted(self.place)}: {error}") from None


def _distinct(items: tuple[Item, ...]) -> tuple[Item, ...]:
    twice = [item for item in dict.fromkeys(items) if items.count(item) > 1]
    if twice:
        raise ValueError(f"{twice[0]!r} stands there twice; name it once.")
    return items


def _path_part(name: str, reserved: tuple[str, ...]) -> str:
    if not NAME.fullmatch(name) or name in reserved:
        raise ValueError(
            f"{name!r} becomes a folder: use letters, digits, '.', '_' and '-', and none of {', '.join(reserved)}."
        )
    return name
