"""The expert stage: copies a trained expert from the zoo, or trains one."""

import shutil
from pathlib import Path

from acgd.experts import zoo
from acgd.experts.kinds import LEARNERS
from acgd.experts.settings import ExpertRequest
from acgd.settings import imported
from acgd.store.stage import Context, Inputs


def train(request: ExpertRequest, inputs: Inputs, ctx: Context) -> None:
    """-> policy.safetensors, policy.json; critic files of an off-policy learner; curve.csv of a trained expert."""
    train_expert = imported(LEARNERS[request.expert.kind].code)
    folder, points = train_expert(request, ctx.state, ctx.metrics, ctx.progress, ctx.device)
    for name in zoo.POLICY + zoo.CRITIC:
        if (folder / name).is_file():
            shutil.copyfile(folder / name, ctx.out / name)
    if points:
        from acgd.experts.curve import write_curve

        write_curve(points, ctx.out / "curve.csv")


def take(request: ExpertRequest, *_: object) -> tuple[Path, list[dict]]:
    """The zoo folder of the task's expert, and no points. FileNotFoundError where the zoo has no such expert."""
    if missing_files := zoo.missing(request.task.name):
        raise FileNotFoundError(
            f"{zoo.folder(request.task.name)} lacks {', '.join(missing_files)}: train an expert (expert.kind: ppo), "
            f"or use a task of the zoo ({zoo.tasks_with(zoo.has_expert)})"
        )
    return zoo.folder(request.task.name), []
