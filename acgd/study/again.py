"""Artifacts that a run of the workflow makes again, although the store has them: --forcerun, --force, --forceall."""

import os
from collections.abc import Collection, Iterable

from acgd.study.names import all_names
from acgd.study.plan import Artifact, Plan

WHOLE = ("all", "publish", "mlflow")
"""Rules that need the whole study."""


def made_again(
    plan: Plan, targets: Collection[str], forced: Collection[str], everything: bool, results: str = "results"
) -> list[Artifact]:
    """The artifacts to make again: the forced ones and what depends on them, as far as the targets need it.

    targets, forced: words of the command line, which name a rule or a file. everything: whether all that the targets
    need is forced (--forceall). The order is that of the plan, in which inputs precede.
    """
    if not forced and not everything:
        return []
    needed = _needed(plan, targets, results)
    needed |= _with_inputs(
        artifact for word in forced if word not in _stages(plan) for artifact in _of(plan, word, results)
    )
    if everything:
        return [artifact for artifact in plan.artifacts.values() if artifact in needed]
    again = {artifact for word in forced for artifact in _of(plan, word, results)}
    for artifact in plan.artifacts.values():
        if not again.isdisjoint(artifact.upstream):
            again.add(artifact)
    return [artifact for artifact in plan.artifacts.values() if artifact in again & needed]


def is_whole(plan: Plan, targets: Collection[str], results: str = "results") -> bool:
    """Whether the targets need the whole study: `all`, the report's page, or a record of a finished action."""
    actions = tuple(f"{results}/work/{action}/{plan.study}/" for action in ("published", "mirrored"))
    page = f"{results}/{plan.study}/report.html"
    return not targets or any(word in (*WHOLE, page) or word.startswith(actions) for word in map(_path, targets))


def _needed(plan: Plan, targets: Collection[str], results: str) -> set[Artifact]:
    """The artifacts that the targets need, finished or not."""
    if is_whole(plan, targets, results):
        return set(plan.artifacts.values())
    return _with_inputs(artifact for word in targets for artifact in _of(plan, word, results))


def _with_inputs(artifacts: Iterable[Artifact]) -> set[Artifact]:
    """The artifacts and everything that they depend on."""
    closed: set[Artifact] = set()
    waiting = list(artifacts)
    while waiting:
        artifact = waiting.pop()
        if artifact not in closed:
            closed.add(artifact)
            waiting += artifact.upstream
    return closed


def _of(plan: Plan, word: str, results: str) -> list[Artifact]:
    """The artifacts that a word names: a stage, a name of the study, or a manifest. Empty for other rules and files."""
    if word in _stages(plan):
        return [artifact for artifact in plan.artifacts.values() if artifact.stage.name == word]
    path = _path(word)
    names, folder = all_names(plan), f"{results}/{plan.study}/"
    if path.startswith(folder) and path.removeprefix(folder) in names:
        return names[path.removeprefix(folder)]
    place = path.removeprefix(f"{results}/store/").removesuffix("/manifest.json")
    return [plan.artifacts[place]] if place in plan.artifacts else []


def _stages(plan: Plan) -> set[str]:
    return {artifact.stage.name for artifact in plan.artifacts.values()}


def _path(word: str) -> str:
    return os.path.normpath(word)
