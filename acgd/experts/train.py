"""The expert stage: take a trained expert from the zoo, or train one."""

import shutil
from pathlib import Path

from acgd.experts import zoo
from acgd.experts.kinds import LEARNERS
from acgd.experts.settings import ExpertRequest
from acgd.settings import imported
from acgd.store.stage import Context, Inputs


def train(request: ExpertRequest, inputs: Inputs, ctx: Context) -> None:
    """Write policy.safetensors and policy.json; the critics of an off-policy learner; curve.csv where the expert is
    trained here."""
    learn = imported(LEARNERS[request.expert.kind].code)
    folder, points = learn(request, ctx.state, ctx.metrics, ctx.progress, ctx.device)
    for name in zoo.POLICY + zoo.CRITIC:
        if (folder / name).is_file():
            shutil.copyfile(folder / name, ctx.out / name)
    if points:
        from acgd.experts.curve import write_curve

        write_curve(points, ctx.out / "curve.csv")


def take(request: ExpertRequest, *_: object) -> tuple[Path, list[dict]]:
    """The folder of a trained expert, and no points. Raises FileNotFoundError where the zoo has none for the task."""
    if absent := zoo.missing(request.task.name):
        raise FileNotFoundError(
            f"{zoo.folder(request.task.name)} lacks {', '.join(absent)}: train an expert (expert.kind: ppo), "
            f"or use a task of the zoo ({zoo.tasks_with(zoo.has_expert)})"
        )
    return zoo.folder(request.task.name), []
