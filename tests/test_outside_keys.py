"""No payload depends on a field outside the key. Each field is tried with two values; all files must be the same."""

import json
from collections.abc import Callable, Iterable, Iterator
from functools import cache
from itertools import product
from pathlib import Path
from typing import Any, get_args

import pytest
import synthetic
import test_critics
import test_experts
import test_vision
from pydantic import BaseModel

from acgd import chain
from acgd.critics.settings import CriticRequest
from acgd.experts.sac import learn as sac
from acgd.experts.settings import CardRequest, ExpertRequest
from acgd.guidance.kinds import GUIDANCE
from acgd.settings import OUTSIDE_KEY, imported
from acgd.store import job
from acgd.store.store import Store
from acgd.students.kinds import STUDENTS
from acgd.study.plan import identity, plan
from acgd.study.study import Study, load_study
from acgd.vision.settings import BackboneRequest, FeaturesRequest


def outside_fields(model: type[BaseModel], place: str) -> Iterator[str]:
    """Places of the fields outside the key: `place.field`, or `place.field[kind].field` in a section with kinds."""
    for name, field in model.model_fields.items():
        here = f"{place}.{name}"
        extra = field.json_schema_extra
        if isinstance(extra, dict) and OUTSIDE_KEY.items() <= extra.items():
            yield here
        for inner in models_in(field.annotation):
            kind = inner.model_fields.get("kind")
            yield from outside_fields(inner, here if kind is None else f"{here}[{kind.default}]")


def models_in(annotation: Any) -> Iterator[type[BaseModel]]:
    """The models that an annotation names: members of unions, items of lists, values of mappings."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for argument in get_args(annotation):
        yield from models_in(argument)


def of_requests() -> set[str]:
    """Places `stage.field` of all stages."""
    return {place for name in chain.names() for place in outside_fields(imported(chain.stage(name).request), name)}


def made(stage: str, request: Any, inputs: dict[str, Any], folder: Path) -> Path:
    """Runs the function of a stage with those of the inputs that the request uses. Returns payload and metrics."""
    roles = {read.role or read.stage: read for read in chain.stage(stage).reads}
    read = {name: role for name, role in roles.items() if not role.optional or request.uses(role.stage)}
    ctx = synthetic.context(folder)
    with ctx.metrics:
        imported(chain.stage(stage).function)(request, {name: inputs[name] for name in read if name in inputs}, ctx)
    return ctx.out


def payload(folder: Path) -> dict[str, bytes]:
    """Name -> content of every file."""
    return {str(file.relative_to(folder)): file.read_bytes() for file in sorted(folder.rglob("*")) if file.is_file()}


# -- the cases: functions (folder, value of the field) -> folders of what was made with that value -----------------


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    return tmp_path_factory.mktemp("inputs")


@pytest.fixture(scope="module")
def trained(folder) -> Callable[[str], Path]:
    """Kind of learner -> folder of an expert that it has trained."""
    return cache(lambda kind: made("expert", learner(kind, 32), {}, folder / kind))


@pytest.fixture(scope="module")
def synthetic_inputs(folder) -> dict[str, Any]:
    """All that a codebook and a student of two tasks read; the student is that of round 0."""
    rollouts, onpolicy = (
        [synthetic.rollouts(folder / f"rollouts-{seed}-{i}", i, seed=seed) for i in range(2)] for seed in (0, 1)
    )
    inputs = {
        "rollouts": rollouts,
        "features": rollouts,
        "critic": [synthetic.critic(folder / f"critic-{i}", 9, seed=i) for i in range(2)],
        "quality": [synthetic.quality(folder / f"quality-{i}", 0.4) for i in range(2)],
    }
    inputs["codebook"] = made("codebook", synthetic.codebook_request(), inputs, folder / "codebook")
    inputs["student"] = made("student", synthetic.student_request(), inputs, folder / "student")
    return inputs | {"onpolicy": onpolicy, "onpolicy_features": onpolicy}


@pytest.fixture(scope="module")
def spots(folder) -> dict[str, Any]:
    """Images for a backbone, and a backbone."""
    rollouts = [test_vision.recorded(folder / f"spots-{i}", seed=i) for i in range(2)]
    request = BackboneRequest(backbone=test_vision.short())
    return {"rollouts": rollouts, "backbone": made("backbone", request, {"rollouts": rollouts}, folder / "backbone")}


def learner(kind: str, checkpoint_every: int) -> ExpertRequest:
    """A tiny expert of a kind. SAC makes checkpoints between its segments alone: see `short_segments`."""
    task = test_experts.REQUESTS[kind].task.name
    return test_experts.small(kind, task, evaluate_every=64, checkpoint_every=checkpoint_every)


@pytest.fixture
def short_segments(monkeypatch):
    monkeypatch.setattr(sac, "SEGMENT", 32)


LEARNERS = ("ppo", "sac", "muscle")


def an_expert(kind: str):
    def make(value: int, place: Path, **_: Any) -> list[Path]:
        return [made("expert", learner(kind, value), {}, place)]

    return make


def a_card(kind: str):
    def make(value: int, place: Path, trained: Callable[[str], Path], **_: Any) -> list[Path]:
        expert = learner(kind, value)
        request = CardRequest(task=expert.task, expert=expert.expert, card={"episodes": 1})
        return [made("card", request, {"expert": trained(kind)}, place)]

    return make


def a_critic(value: int, place: Path, trained: Callable[[str], Path], **_: Any) -> list[Path]:
    settings = test_critics.TINY.model_copy(update={"checkpoint_every": value})
    request = CriticRequest(task=test_experts.REQUEST.task, critic=settings)
    return [made("critic", request, {"expert": trained("ppo")}, place)]


def a_backbone(value: int, place: Path, spots: dict[str, Any], **_: Any) -> list[Path]:
    return [made("backbone", BackboneRequest(backbone=test_vision.short(checkpoint_every=value)), spots, place)]


def some_features(stage: str):
    def make(value: int, place: Path, spots: dict[str, Any], **_: Any) -> list[Path]:
        request = FeaturesRequest(backbone=test_vision.short(checkpoint_every=value))
        return [made(stage, request, spots | {"rollouts": spots["rollouts"][0]}, place)]

    return make


def a_codebook(value: int, place: Path, synthetic_inputs: dict[str, Any], **_: Any) -> list[Path]:
    request = synthetic.codebook_request(training={"checkpoint_every": value})
    return [made("codebook", request, synthetic_inputs, place)]


def students(kinds: Iterable[str], settings: Callable[[int], dict[str, Any]]):
    """Of these kinds, each with every kind of guidance. settings: value -> arguments of synthetic.student_request."""

    def make(value: int, place: Path, synthetic_inputs: dict[str, Any], **_: Any) -> list[Path]:
        return [
            made(
                "student",
                synthetic.student_request(kind, synthetic.GUIDANCE[guidance], **settings(value)),
                synthetic_inputs,
                place / kind / guidance,
            )
            for kind, guidance in product(kinds, GUIDANCE)
        ]

    return make


CADENCES = (1, 1000)
"""Steps between checkpoints: one after each step, and none."""

CASES = {
    **{f"expert.expert[{kind}].checkpoint_every": (CADENCES, an_expert(kind)) for kind in LEARNERS},
    **{f"card.expert[{kind}].checkpoint_every": (CADENCES, a_card(kind)) for kind in LEARNERS},
    "critic.critic[fqe].checkpoint_every": (CADENCES, a_critic),
    "backbone.backbone[privileged].checkpoint_every": (CADENCES, a_backbone),
    "features.backbone[privileged].checkpoint_every": (CADENCES, some_features("features")),
    "onpolicy_features.backbone[privileged].checkpoint_every": (CADENCES, some_features("onpolicy_features")),
    "codebook.student[acgd].codebook.training.checkpoint_every": (CADENCES, a_codebook),
    "student.student[acgd].codebook.training.checkpoint_every": (
        CADENCES,
        students(["acgd"], lambda value: {"codebook": {"training": {"checkpoint_every": value}}}),
    ),
    "student.training.checkpoint_every": (
        CADENCES,
        students(STUDENTS, lambda value: {"training": {"checkpoint_every": value}}),
    ),
    "student.rounds.count": (
        (1, 3),
        students(["acgd"], lambda value: {"round": 1, "rounds": {"count": value, "steps": 4}}),
    ),
}
"""Place -> two values of the field, and what makes the artifacts with one of them."""


def test_every_field_outside_the_key_has_a_case():
    assert set(CASES) == of_requests()
    of_study = {place.partition(".")[2] for place in outside_fields(Study, "study")}
    assert of_study == {place.partition(".")[2] for place in CASES} | {"device"}


@pytest.mark.parametrize("place", CASES)
def test_no_byte_depends_on_a_field_outside_the_key(place, tmp_path, short_segments, trained, synthetic_inputs, spots):
    values, make = CASES[place]
    given = {"trained": trained, "synthetic_inputs": synthetic_inputs, "spots": spots}
    ones, others = (make(value, tmp_path / str(value), **given) for value in values)
    for one, other in zip(ones, others, strict=True):
        assert payload(one) == payload(other) != {}


def test_no_byte_depends_on_the_device_setting_where_both_name_the_processor(tmp_path, monkeypatch):
    """A GPU rounds sums differently: there the setting does change bytes, and run.json says which device was used."""
    monkeypatch.setattr("torch.cuda.is_available", lambda: False)
    settings = {"kind": "ppo", **test_experts.SMALL["ppo"]}
    payloads = []
    for device in ("cpu", "auto"):
        study = {"name": "t", "tasks": ["myo/pen-twirl"], "expert": settings, "device": device}
        planned = plan(load_study(study))
        artifact = planned.names["base/myo-pen-twirl/expert"][0]
        store = Store(tmp_path / device)
        job.make(json.loads(artifact.job), artifact.stage, identity, store, threads=1, device=device)
        payloads.append(store.manifest(artifact.place))
    assert payloads[0] == payloads[1] and payloads[0]["payload"]
