"""From a study to the artifacts it needs: each once, however many variants use it, and each with just what it reads."""

from collections.abc import Iterable
from dataclasses import dataclass, field
from functools import cached_property

from acgd.collection.settings import RolloutsRequest
from acgd.critics.settings import CriticConfig, CriticRequest
from acgd.evaluation.settings import ControlsRequest, EvaluationRequest
from acgd.experts import zoo
from acgd.experts.settings import ExpertRequest, ExpertSettings
from acgd.reports.settings import ReportEntry, ReportRequest
from acgd.settings import Section
from acgd.store.key import canonical, identity, in_key, key_of
from acgd.students.settings import CodebookRequest, StudentRequest
from acgd.study.study import Settings, Study, TaskSettings
from acgd.tasks.settings import TaskConfig
from acgd.vision.settings import BackboneRequest, FeaturesRequest

Upstream = dict[str, "Artifact | tuple[Artifact, ...]"]


@dataclass(frozen=True, eq=False)
class Artifact:
    """One artifact: made, or to be made, in `results/store/<place>`."""

    stage: str
    name: str
    request: Section
    inputs: Upstream

    @cached_property
    def key(self) -> str:
        return key_of(identity(self.stage, self.request, self.input_keys, zoo.read_by(self.stage, self.request)))

    @property
    def place(self) -> str:
        return f"{self.stage}/{self.name}/{self.key}"

    @property
    def input_keys(self) -> dict[str, str | list[str]]:
        return {
            role: given.key if isinstance(given, Artifact) else [one.key for one in given]
            for role, given in self.inputs.items()
        }

    @property
    def input_places(self) -> dict[str, str | list[str]]:
        return {
            role: given.place if isinstance(given, Artifact) else [one.place for one in given]
            for role, given in self.inputs.items()
        }

    @property
    def upstream(self) -> list["Artifact"]:
        flat = [given if isinstance(given, tuple) else (given,) for given in self.inputs.values()]
        return list(dict.fromkeys(one for group in flat for one in group))

    @property
    def job(self) -> str:
        """All that a process needs to make it, as canonical JSON."""
        request = self.request.model_dump(mode="json")
        return canonical(
            {"stage": self.stage, "name": self.name, "key": self.key, "request": request, "inputs": self.input_places}
        )


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

    def name(self, variant: str, stage: str, artifacts: Iterable[Artifact], items: Iterable[str] = ()) -> None:
        """`items` tell the artifacts of one stage apart: task slugs, or seeds."""
        artifacts = list(artifacts)
        if artifacts:
            self.names[f"{variant}/{stage}"] = list(dict.fromkeys(artifacts))
        for item, artifact in zip(items, artifacts, strict=False):
            self.names[f"{variant}/{item}/{stage}"] = [artifact]

    def names_of(self, artifact: Artifact) -> list[str]:
        """The most telling names of an artifact: those that mean it alone, where there are any."""
        if artifact is self.report:
            return ["report"]
        named = [name for name, artifacts in self.names.items() if artifact in artifacts]
        alone = [name for name in named if len(self.names[name]) == 1]
        items = [name for name in alone if name.count("/") == 2]
        return items or alone or named


@dataclass(frozen=True)
class Chain:
    """What one variant is made of. Per-task stages in the order of the tasks, the others in the order of the seeds."""

    expert: tuple[Artifact, ...]
    critic: tuple[Artifact, ...]
    rollouts: tuple[Artifact, ...]
    backbone: Artifact
    features: tuple[Artifact, ...]
    codebook: tuple[Artifact, ...]
    student: tuple[Artifact, ...]
    evaluation: tuple[Artifact, ...]
    controls: Artifact


def plan(study: Study) -> Plan:
    """Everything that the study needs."""
    result = Plan(study.name)
    chains = {name: _chain(result, settings) for name, settings in study.resolved.items()}
    for name, chain in chains.items():
        _name_all(result, name, study.resolved[name], chain)
    result.report = result.add(_report(study, chains))
    return result


def _chain(plan: Plan, settings: Settings) -> Chain:
    tasks = [each.task for each in settings.each_task]
    expert = tuple(plan.add(_expert(each)) for each in settings.each_task)
    rollouts = tuple(
        plan.add(
            Artifact(
                "rollouts", slug(each.task), RolloutsRequest(task=each.task, rollouts=each.rollouts), {"expert": made}
            )
        )
        for each, made in zip(settings.each_task, expert, strict=True)
    )
    guided = settings.student.guidance == "critic"
    critic = tuple(
        plan.add(_critic(each, made)) for each, made in zip(settings.each_task, expert, strict=True) if guided
    )
    backbone = plan.add(_backbone(settings, tasks, rollouts))
    features: tuple[Artifact, ...] = ()
    if settings.backbone.kind != "scratch":
        request = FeaturesRequest(features=settings.features)
        features = tuple(
            plan.add(Artifact("features", slug(task), request, {"rollouts": one, "backbone": backbone}))
            for task, one in zip(tasks, rollouts, strict=True)
        )
    codebooks, students, evaluations = [], [], []
    for seed in settings.seeds:
        name = f"{group(tasks)}-seed-{seed}"
        shared = {"tasks": tasks, "codebook": settings.codebook, "backbone": settings.backbone.used(), "seed": seed}
        seen: Upstream = {"rollouts": rollouts, "features": features} if features else {"rollouts": rollouts}
        codebook = plan.add(Artifact("codebook", name, CodebookRequest(**shared), seen))
        inputs: Upstream = (
            {**seen, "codebook": codebook, "critics": critic} if guided else {**seen, "codebook": codebook}
        )
        student = plan.add(Artifact("student", name, StudentRequest(**shared, student=settings.student), inputs))
        evaluation = plan.add(
            Artifact(
                "evaluation",
                name,
                EvaluationRequest(tasks=tuple(tasks), evaluation=settings.evaluation, seed=seed),
                {"student": student, "backbone": backbone, "rollouts": rollouts, "experts": expert},
            )
        )
        codebooks.append(codebook)
        students.append(student)
        evaluations.append(evaluation)
    controls = ControlsRequest(tasks=tuple(tasks), controls=settings.controls)
    return Chain(
        expert=expert,
        critic=critic,
        rollouts=rollouts,
        backbone=backbone,
        features=features,
        codebook=tuple(codebooks),
        student=tuple(students),
        evaluation=tuple(evaluations),
        controls=plan.add(Artifact("controls", group(tasks), controls, {"rollouts": rollouts, "experts": expert})),
    )


def _expert(each: TaskSettings) -> Artifact:
    """An expert from the zoo depends on the zoo's files, and on no setting of a training that does not happen."""
    if each.expert.source == "train":
        return Artifact("expert", slug(each.task), ExpertRequest(task=each.task, expert=each.expert.only_used()), {})
    request = ExpertRequest(task=each.task, expert=ExpertSettings(source="zoo"))
    return Artifact("expert", slug(each.task), request, {})


def _critic(each: TaskSettings, expert: Artifact) -> Artifact:
    """A critic from the zoo depends on its files, and on no setting of a fit that does not happen."""
    if each.critic.source == "zoo":
        request = CriticRequest(task=each.task, critic=CriticConfig(source="zoo"))
        return Artifact("critic", slug(each.task), request, {"expert": expert})
    return Artifact("critic", slug(each.task), CriticRequest(task=each.task, critic=each.critic), {"expert": expert})


def _backbone(settings: Settings, tasks: list[TaskConfig], rollouts: tuple[Artifact, ...]) -> Artifact:
    """Only a privileged backbone is trained, on frames of the tasks; the others are the same for all tasks."""
    kind = settings.backbone.kind
    if kind != "privileged":
        return Artifact("backbone", kind, BackboneRequest(tasks=[], backbone=settings.backbone), {})
    return Artifact(
        "backbone",
        f"{kind}-{group(tasks)}",
        BackboneRequest(tasks=tasks, backbone=settings.backbone),
        {"rollouts": rollouts},
    )


def _report(study: Study, chains: dict[str, Chain]) -> Artifact:
    stages = list(Chain.__dataclass_fields__)
    made: dict[str, dict[Artifact, int]] = {stage: {} for stage in stages}

    def position(artifact: Artifact) -> int:
        return made[artifact.stage].setdefault(artifact, len(made[artifact.stage]))

    entries = [
        ReportEntry(
            variant=name,
            seed=seed,
            student=position(chain.student[i]),
            evaluation=position(chain.evaluation[i]),
            codebook=position(chain.codebook[i]),
            backbone=position(chain.backbone),
            expert=tuple(map(position, chain.expert)),
            critic=tuple(map(position, chain.critic)),
            rollouts=tuple(map(position, chain.rollouts)),
            features=tuple(map(position, chain.features)),
            controls=position(chain.controls),
        )
        for name, chain in chains.items()
        for i, seed in enumerate(study.resolved[name].seeds)
    ]
    configuration = in_key(study)
    request = ReportRequest(
        study=study.name, tasks=study.tasks, entries=tuple(entries), report=study.report, configuration=configuration
    )
    inputs: Upstream = {stage: tuple(artifacts) for stage, artifacts in made.items() if artifacts}
    return Artifact("report", study.name, request, inputs)


def _name_all(plan: Plan, variant: str, settings: Settings, chain: Chain) -> None:
    slugs = [slug(each.task) for each in settings.each_task]
    seeds = [f"seed-{seed}" for seed in settings.seeds]
    for stage in ("expert", "critic", "rollouts", "features"):
        plan.name(variant, stage, getattr(chain, stage), slugs)
    for stage in ("codebook", "student", "evaluation"):
        plan.name(variant, stage, getattr(chain, stage), seeds)
    plan.name(variant, "backbone", [chain.backbone])
    plan.name(variant, "controls", [chain.controls])


def slug(task: TaskConfig) -> str:
    """`myo/key-turn` -> `myo-key-turn`."""
    return task.name.replace("/", "-")


def group(tasks: list[TaskConfig]) -> str:
    """What artifacts of several tasks are called."""
    return slug(tasks[0]) if len(tasks) == 1 else f"{len(tasks)}-tasks"
