"""The plan of a study: its artifacts. Variants share equal artifacts. A request holds only the settings of its stage.

The table of stages (acgd/chain.py) declares the axes and the inputs of each stage. The plan begins with the stages
that every variant wants, such as `evaluation`, and adds the inputs of each artifact recursively.
"""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from itertools import product
from typing import Any

from acgd import chain
from acgd.evaluation.settings import Condition
from acgd.reports.settings import ReportEntry, ReportRequest
from acgd.settings import Request, imported
from acgd.store import key
from acgd.store.stage import Axis, Read, Stage
from acgd.students.settings import ActingConfig
from acgd.study.study import PER_TASK, Settings, Study
from acgd.tasks import definition
from acgd.tasks.settings import TaskConfig

Upstream = dict[str, "Artifact | tuple[Artifact, ...]"]
At = Mapping[Axis, int]
"""Axis -> value, of one artifact: student seed, round, and indices of condition and task in the study's lists."""


@dataclass(frozen=True, eq=False)
class Artifact:
    """One artifact of `results/store/<place>`, finished or not."""

    stage: Stage
    name: str
    request: Request
    inputs: Upstream

    @cached_property
    def key(self) -> str:
        return key.key_of(identity(self.stage, self.request, self.input_keys))

    @property
    def place(self) -> str:
        return f"{self.stage.name}/{self.name}/{self.key}"

    @property
    def input_keys(self) -> dict[str, str | list[str]]:
        return {
            role: artifacts.key if isinstance(artifacts, Artifact) else [artifact.key for artifact in artifacts]
            for role, artifacts in self.inputs.items()
        }

    @property
    def input_places(self) -> dict[str, str | list[str]]:
        return {
            role: artifacts.place if isinstance(artifacts, Artifact) else [artifact.place for artifact in artifacts]
            for role, artifacts in self.inputs.items()
        }

    @property
    def upstream(self) -> list["Artifact"]:
        """All inputs, each once."""
        groups = [inputs if isinstance(inputs, tuple) else (inputs,) for inputs in self.inputs.values()]
        return list(dict.fromkeys(artifact for group in groups for artifact in group))

    @property
    def job(self) -> str:
        """Canonical JSON with everything that a process needs to make the artifact."""
        request = self.request.model_dump(mode="json")
        inputs = self.input_places
        return key.canonical(
            {"stage": self.stage.name, "name": self.name, "key": self.key, "request": request, "inputs": inputs}
        )


def identity(stage: Stage, request: Request, inputs: key.InputKeys) -> dict[str, Any]:
    """The content that an artifact's key hashes, with the digests of the tasks that the stage simulates or draws."""
    return key.identity(stage, request, inputs, world(stage, request))


def world(stage: Stage, request: Request) -> dict[str, Any]:
    """Task -> digests of the sources that define its episodes and pictures, and versions of the packages they use.

    Empty for a stage that neither simulates nor draws.
    """
    if not (stage.simulates or stage.draws):
        return {}
    tasks: list[TaskConfig] = [request.task] if hasattr(request, "task") else list(request.tasks)
    return {task.name: _task_world(stage, task.name) for task in tasks}


def _task_world(stage: Stage, task: str) -> dict[str, Any]:
    digests, packages = definition.definition(task), dict(definition.packages(task))
    content = {"episode": digests.episode}
    if stage.draws:
        content["picture"] = digests.picture
        packages |= definition.drawing_packages()
    return content | {"packages": packages}


@dataclass
class Plan:
    """The artifacts of a study and their names."""

    study: str
    artifacts: dict[str, Artifact] = field(default_factory=dict)
    """Place -> artifact. Upstream artifacts precede downstream ones."""
    names: dict[str, list[Artifact]] = field(default_factory=dict)
    """`<variant>/<stage>` and `<variant>/<item>/<stage>` -> artifacts."""
    report: Artifact | None = None

    def add(self, artifact: Artifact) -> Artifact:
        """Adds the artifact, unless the plan has one with the same place. Returns the plan's artifact."""
        return self.artifacts.setdefault(artifact.place, artifact)

    def names_of(self, artifact: Artifact) -> list[str]:
        """Names of an artifact. Names of this artifact alone are preferred; of these, the more specific ones."""
        if artifact is self.report:
            return [chain.REPORT.name]
        named = [name for name, artifacts in self.names.items() if artifact in artifacts]
        alone = [name for name in named if len(self.names[name]) == 1]
        return [name for name in alone if name.count("/") > 1] or alone or named


def plan(study: Study) -> Plan:
    """All artifacts that the study needs, finished or not."""
    result = Plan(study.name)
    variants = {name: _Variant(result, settings) for name, settings in study.resolved.items()}
    for name, variant in variants.items():
        variant.add_wanted()
        result.names |= {f"{name}/{item}": artifacts for item, artifacts in variant.names()}
    result.report = result.add(_report(study, variants))
    return result


class _Variant:
    """The artifacts of one variant, added to the plan as other artifacts need them."""

    def __init__(self, plan: Plan, settings: Settings) -> None:
        self.plan, self.settings = plan, settings
        self.conditions = tuple(dict.fromkeys(self._condition(condition) for condition in settings.conditions))
        self.artifacts: dict[str, dict[tuple[tuple[Axis, int], ...], Artifact]] = {}
        """Stage -> values of its axes -> artifact."""
        self.axes: dict[Axis, tuple[int, ...]] = {
            "seed": settings.seeds,
            "round": tuple(range(settings.rounds.count + 1)),
            "condition": tuple(range(len(self.conditions))),
            "task": tuple(range(len(settings.tasks))),
        }

    def add_wanted(self) -> None:
        """Adds the stages that every variant wants, then those that accompany another stage (`Stage.beside`)."""
        for stage in chain.STAGES.values():
            if stage.wanted:
                self.all_of(stage)
        for stage in chain.STAGES.values():
            if stage.beside in self.artifacts:
                self.all_of(stage)

    def all_of(self, stage: Stage) -> list[Artifact]:
        """The artifacts of a stage for all values of its axes."""
        return [self.artifact(stage, at) for at in self.places(stage.per, stage)]

    def places(self, axes: Iterable[Axis], stage: Stage) -> Iterator[At]:
        """All combinations of the values of `axes`."""
        axes = tuple(axes)
        values = [tuple(v for v in self.axes[axis] if axis != "round" or v >= stage.first_round) for axis in axes]
        return (dict(zip(axes, choice, strict=True)) for choice in product(*values))

    def artifact(self, stage: Stage, at: At) -> Artifact:
        """The artifact of a stage. Adds it and its inputs to the plan."""
        at = {axis: at[axis] for axis in stage.per}
        of_stage, values = self.artifacts.setdefault(stage.name, {}), tuple(at.items())
        if values not in of_stage:
            request = self.request(stage, at)
            inputs = {
                read.role or read.stage: artifacts
                for read in stage.reads
                if (artifacts := self.input(read, request, at))
            }
            name = request.artifact_name(self.default_name(at))
            of_stage[values] = self.plan.add(Artifact(stage, name, request, inputs))
        return of_stage[values]

    def exists(self, stage: Stage) -> bool:
        """Whether this variant can have artifacts of the stage."""
        return next((self.request(stage, at).exists() for at in self.places(stage.per, stage)), False)

    def input(self, read: Read, request: Request, at: At) -> "Artifact | tuple[Artifact, ...] | None":
        """The artifacts that an artifact reads of one stage. None if the input is optional and absent."""
        stage = chain.STAGES[read.stage]
        if read.optional and not (request.uses(read.stage) and self.exists(stage)):
            return None
        at = {"condition": 0, **at}
        rounds: tuple[int, ...] = ()
        if "round" in stage.per:
            current = at.get("round", self.axes["round"][-1])
            so_far = tuple(range(stage.first_round, current + 1))
            rounds = {"same": (current,), "last": (current,), "so far": so_far, "previous": (current - 1,)}[read.rounds]
            rounds = tuple(number for number in rounds if number >= stage.first_round)
            if not rounds:
                return None
        missing: list[Axis] = [axis for axis in stage.per if axis not in at and axis != "round"]
        places = [{**at, "round": number, **rest} for number in rounds or (0,) for rest in self.places(missing, stage)]
        artifacts = tuple(self.artifact(stage, place) for place in places)
        return artifacts if missing or read.rounds == "so far" else artifacts[0]

    def request(self, stage: Stage, at: At) -> Request:
        """The request. Each field is an axis of the artifact or the variant's section of the same name."""
        settings, number = self.settings, at.get("round", 0)
        # All ways of acting are one where no chunks overlap, so that they must not tell keys apart.
        overlap = settings.student.chunk > 1 and not settings.student.recurrent
        fields: dict[str, Any] = {
            "tasks": tuple(task_settings.task for task_settings in settings.each_task),
            "seed": at.get("seed"),
            "round": number,
            "rounds": settings.rounds if number else None,
            "condition": self.conditions[at.get("condition", 0)],
            "acting": settings.acting if overlap else ActingConfig(),
        }
        if "task" in at:
            fields |= {name: getattr(settings.each_task[at["task"]], name) for name in PER_TASK}
        kind = imported(stage.request)
        return kind(**{name: fields[name] if name in fields else getattr(settings, name) for name in kind.model_fields})

    def _condition(self, condition: Condition) -> Condition:
        """The condition as the student meets it: its goal is of the kind of its training."""
        goal = {"off": "none", "vector": "commanded"}.get(self.settings.imitation.goal, condition.goal)
        return condition.model_copy(update={"goal": goal})

    def default_name(self, at: At) -> str:
        """Name of an artifact: its task or number of tasks, its seed and its round, as far as it has them."""
        tasks = [name.replace("/", "-") for name in self.settings.tasks]
        parts = [tasks[at["task"]] if "task" in at else tasks[0] if len(tasks) == 1 else f"{len(tasks)}-tasks"]
        parts += [f"seed-{at['seed']}"] if "seed" in at else []
        parts += [f"round-{at['round']}"] if at.get("round") else []
        return "-".join(parts)

    def names(self) -> Iterator[tuple[str, list[Artifact]]]:
        """(name, artifacts): `<stage>` for all artifacts of a stage, and `<seed>/<round>/<task>/<stage>` by axes."""
        for stage, of_stage in self.artifacts.items():
            yield stage, list(dict.fromkeys(of_stage.values()))
            items: dict[str, list[Artifact]] = {}
            for at, artifact in of_stage.items():
                for item in self.items(dict(at)):
                    items.setdefault(item, []).append(artifact)
            yield from ((f"{item}/{stage}", artifacts) for item, artifacts in items.items())

    def items(self, at: At) -> Iterator[str]:
        """Names `<seed>/<round>/<task>` of an artifact. A student of the last round also has one without the round."""
        seed = [f"seed-{at['seed']}"] if "seed" in at else []
        task = [self.settings.tasks[at["task"]].replace("/", "-")] if "task" in at else []
        rounds = [f"round-{at['round']}"] if "round" in at and len(self.axes["round"]) > 1 else []
        if "round" in at and "task" not in at and at["round"] == self.axes["round"][-1]:
            yield "/".join(seed)
        if rounds or "round" not in at:
            if item := "/".join([*seed, *rounds, *task]):
                yield item

    def entry(self, stage: str, seed: int) -> list[Artifact]:
        """The artifacts of a stage that the student of a seed depends on, in the order of the stage's other axes."""
        of_stage = sorted(self.artifacts.get(stage, {}).items())
        return [artifact for at, artifact in of_stage if dict(at).get("seed", seed) == seed]


def _report(study: Study, variants: Mapping[str, _Variant]) -> Artifact:
    """The report's artifact. It reads every artifact once. An entry per student holds the indices of its artifacts."""
    inputs: dict[str, dict[Artifact, int]] = {stage: {} for stage in chain.STAGES}

    def places(stage: str, artifacts: Iterable[Artifact]) -> tuple[int, ...]:
        return tuple(inputs[stage].setdefault(artifact, len(inputs[stage])) for artifact in artifacts)

    entries = [
        ReportEntry(
            variant=name,
            seed=seed,
            artifacts={
                stage: places(stage, variant.entry(stage, seed)) for stage in chain.STAGES if stage in variant.artifacts
            },
        )
        for name, variant in variants.items()
        for seed in variant.settings.seeds
    ]
    request = ReportRequest(
        study=study.name,
        tasks=study.tasks,
        entries=tuple(entries),
        report=study.report,
        configuration=key.in_key(study),
    )
    listed = {stage: tuple(artifacts) for stage, artifacts in inputs.items() if artifacts}
    return Artifact(chain.REPORT, study.name, request, listed)
