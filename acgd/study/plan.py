"""From a study to the artifacts it needs: each once, however many variants use it, and each with just what it reads.

The table of stages (acgd/chain.py) says what a stage is made per and what it reads. Artifacts are found from the end: a
variant wants its evaluations, and each artifact asks for its inputs.
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
"""Which artifact of a stage: student seed, round, and the places of condition and task in the study's lists."""


@dataclass(frozen=True, eq=False)
class Artifact:
    """One artifact: made, or to be made, in `results/store/<place>`."""

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
            role: one.key if isinstance(one, Artifact) else [each.key for each in one]
            for role, one in self.inputs.items()
        }

    @property
    def input_places(self) -> dict[str, str | list[str]]:
        return {
            role: one.place if isinstance(one, Artifact) else [each.place for each in one]
            for role, one in self.inputs.items()
        }

    @property
    def upstream(self) -> list["Artifact"]:
        groups = [given if isinstance(given, tuple) else (given,) for given in self.inputs.values()]
        return list(dict.fromkeys(one for group in groups for one in group))

    @property
    def job(self) -> str:
        """All that a process needs to make it, as canonical JSON."""
        request = self.request.model_dump(mode="json")
        inputs = self.input_places
        return key.canonical(
            {"stage": self.stage.name, "name": self.name, "key": self.key, "request": request, "inputs": inputs}
        )


def identity(stage: Stage, request: Request, inputs: key.InputKeys) -> dict[str, Any]:
    """What the key of an artifact hashes, with what defines the tasks that the stage simulates or draws."""
    return key.identity(stage, request, inputs, world(stage, request))


def world(stage: Stage, request: Request) -> dict[str, Any]:
    """Task -> digests of what defines its episodes and pictures, and the versions of packages behind them."""
    if not (stage.simulates or stage.draws):
        return {}
    tasks: list[TaskConfig] = [request.task] if hasattr(request, "task") else list(request.tasks)
    return {task.name: _of_task(stage, task.name) for task in tasks}


def _of_task(stage: Stage, task: str) -> dict[str, Any]:
    digests, packages = definition.definition(task), dict(definition.packages(task))
    of_task = {"episode": digests.episode}
    if stage.draws:
        of_task["picture"] = digests.picture
        packages |= definition.drawing_packages()
    return of_task | {"packages": packages}


@dataclass
class Plan:
    """The artifacts of a study, and the names that people use for them."""

    study: str
    artifacts: dict[str, Artifact] = field(default_factory=dict)
    """Place -> artifact, upstream before downstream."""
    names: dict[str, list[Artifact]] = field(default_factory=dict)
    """`<variant>/<stage>` and `<variant>/<item>/<stage>` -> artifacts."""
    report: Artifact | None = None

    def add(self, artifact: Artifact) -> Artifact:
        """The artifact, or the equal one that is there already."""
        return self.artifacts.setdefault(artifact.place, artifact)

    def names_of(self, artifact: Artifact) -> list[str]:
        """The most telling names of an artifact: those that mean it alone, where there are any."""
        if artifact is self.report:
            return [chain.REPORT.name]
        named = [name for name, artifacts in self.names.items() if artifact in artifacts]
        alone = [name for name in named if len(self.names[name]) == 1]
        return [name for name in alone if name.count("/") > 1] or alone or named


def plan(study: Study) -> Plan:
    """Everything that the study needs."""
    result = Plan(study.name)
    variants = {name: _Variant(result, settings) for name, settings in study.resolved.items()}
    for name, variant in variants.items():
        variant.make_wanted()
        result.names |= {f"{name}/{item}": artifacts for item, artifacts in variant.names()}
    result.report = result.add(_report(study, variants))
    return result


class _Variant:
    """The artifacts of one variant, made as they are asked for."""

    def __init__(self, plan: Plan, settings: Settings) -> None:
        self.plan, self.settings = plan, settings
        self.conditions = tuple(dict.fromkeys(self._condition(condition) for condition in settings.conditions))
        self.made: dict[str, dict[tuple[tuple[Axis, int], ...], Artifact]] = {}
        """Stage -> where on its axes -> artifact."""
        self.axes: dict[Axis, tuple[int, ...]] = {
            "seed": settings.seeds,
            "round": tuple(range(settings.rounds.count + 1)),
            "condition": tuple(range(len(self.conditions))),
            "task": tuple(range(len(settings.tasks))),
        }

    def make_wanted(self) -> None:
        for stage in chain.STAGES.values():
            if stage.wanted:
                self.all_of(stage)
        for stage in chain.STAGES.values():
            if stage.beside in self.made:
                self.all_of(stage)

    def all_of(self, stage: Stage) -> list[Artifact]:
        return [self.artifact(stage, at) for at in self.places(stage.per, stage)]

    def places(self, axes: Iterable[Axis], stage: Stage) -> Iterator[At]:
        """Every combination of values of `axes`."""
        axes = tuple(axes)
        values = [tuple(v for v in self.axes[axis] if axis != "round" or v >= stage.first_round) for axis in axes]
        return (dict(zip(axes, choice, strict=True)) for choice in product(*values))

    def artifact(self, stage: Stage, at: At) -> Artifact:
        """The artifact of a stage, with everything upstream of it."""
        at = {axis: at[axis] for axis in stage.per}
        made, here = self.made.setdefault(stage.name, {}), tuple(at.items())
        if here not in made:
            request = self.request(stage, at)
            inputs = {
                read.role or read.stage: given for read in stage.reads if (given := self.input(read, request, at))
            }
            name = request.artifact_name(self.default_name(at))
            made[here] = self.plan.add(Artifact(stage, name, request, inputs))
        return made[here]

    def exists(self, stage: Stage) -> bool:
        """Whether this variant can have artifacts of the stage."""
        return next((self.request(stage, at).exists() for at in self.places(stage.per, stage)), False)

    def input(self, read: Read, request: Request, at: At) -> "Artifact | tuple[Artifact, ...] | None":
        """What an artifact reads of one stage; nothing where that is optional and not there."""
        stage = chain.STAGES[read.stage]
        if read.optional and not (request.uses(read.stage) and self.exists(stage)):
            return None
        at = {"condition": 0, **at}
        rounds: tuple[int, ...] = ()
        if "round" in stage.per:
            here = at.get("round", self.axes["round"][-1])
            so_far = tuple(range(stage.first_round, here + 1))
            rounds = {"same": (here,), "last": (here,), "so far": so_far, "previous": (here - 1,)}[read.rounds]
            rounds = tuple(number for number in rounds if number >= stage.first_round)
            if not rounds:
                return None
        missing: list[Axis] = [axis for axis in stage.per if axis not in at and axis != "round"]
        spread = [{**at, "round": number, **rest} for number in rounds or (0,) for rest in self.places(missing, stage)]
        artifacts = tuple(self.artifact(stage, place) for place in spread)
        return artifacts if missing or read.rounds == "so far" else artifacts[0]

    def request(self, stage: Stage, at: At) -> Request:
        """Each field by its name: an axis of the artifact, or the section of that name."""
        settings, number = self.settings, at.get("round", 0)
        # All ways of acting are one where a chunk is one action, so that they must not tell keys apart.
        given: dict[str, Any] = {
            "tasks": tuple(each.task for each in settings.each_task),
            "seed": at.get("seed"),
            "round": number,
            "rounds": settings.rounds if number else None,
            "condition": self.conditions[at.get("condition", 0)],
            "acting": settings.acting if settings.student.chunk > 1 else ActingConfig(),
        }
        if "task" in at:
            given |= {name: getattr(settings.each_task[at["task"]], name) for name in PER_TASK}
        kind = imported(stage.request)
        return kind(**{name: given[name] if name in given else getattr(settings, name) for name in kind.model_fields})

    def _condition(self, condition: Condition) -> Condition:
        """The condition as the student meets it: its goal is of the kind of its training."""
        goal = {"off": "none", "vector": "commanded"}.get(self.settings.imitation.goal, condition.goal)
        return condition.model_copy(update={"goal": goal})

    def default_name(self, at: At) -> str:
        """Its task, or its group of tasks; its seed and round."""
        tasks = [name.replace("/", "-") for name in self.settings.tasks]
        parts = [tasks[at["task"]] if "task" in at else tasks[0] if len(tasks) == 1 else f"{len(tasks)}-tasks"]
        parts += [f"seed-{at['seed']}"] if "seed" in at else []
        parts += [f"round-{at['round']}"] if at.get("round") else []
        return "-".join(parts)

    def names(self) -> Iterator[tuple[str, list[Artifact]]]:
        """`<stage>` for all artifacts of a stage, and `<seed>/<round>/<task>/<stage>`, as far as it has these axes."""
        for stage, made in self.made.items():
            yield stage, list(dict.fromkeys(made.values()))
            items: dict[str, list[Artifact]] = {}
            for at, artifact in made.items():
                for item in self.items(dict(at)):
                    items.setdefault(item, []).append(artifact)
            yield from ((f"{item}/{stage}", artifacts) for item, artifacts in items.items())

    def items(self, at: At) -> Iterator[str]:
        """Names of an artifact's place; the student of the last round is known without its round, too."""
        seed = [f"seed-{at['seed']}"] if "seed" in at else []
        task = [self.settings.tasks[at["task"]].replace("/", "-")] if "task" in at else []
        rounds = [f"round-{at['round']}"] if "round" in at and len(self.axes["round"]) > 1 else []
        if "round" in at and "task" not in at and at["round"] == self.axes["round"][-1]:
            yield "/".join(seed)
        if rounds or "round" not in at:
            if item := "/".join([*seed, *rounds, *task]):
                yield item

    def entry(self, stage: str, seed: int) -> list[Artifact]:
        """The artifacts of a stage behind the student of that seed, in the order of its other axes."""
        return [one for at, one in sorted(self.made.get(stage, {}).items()) if dict(at).get("seed", seed) == seed]


def _report(study: Study, variants: Mapping[str, _Variant]) -> Artifact:
    """Reads every artifact once; an entry for each student says where its own stand."""
    inputs: dict[str, dict[Artifact, int]] = {stage: {} for stage in chain.STAGES}

    def places(stage: str, artifacts: Iterable[Artifact]) -> tuple[int, ...]:
        return tuple(inputs[stage].setdefault(one, len(inputs[stage])) for one in artifacts)

    entries = [
        ReportEntry(
            variant=name,
            seed=seed,
            artifacts={
                stage: places(stage, variant.entry(stage, seed)) for stage in chain.STAGES if stage in variant.made
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
    made = {stage: tuple(artifacts) for stage, artifacts in inputs.items() if artifacts}
    return Artifact(chain.REPORT, study.name, request, made)
