"""The chain: the one table of its stages.

Plan, keys, names, the workflow's rules, the command line, the report's entries and MLflow read this table. A new stage
is one row here and one file with its Request and its function.
"""

from acgd.store.stage import Read, Stage

_TABLE = (
    # Single-task RL on the privileged state, or a trained expert from zoo/.
    Stage(
        name="expert",
        version=1,
        request="acgd.experts.settings:ExpertRequest",
        function="acgd.experts.train:train",
        per=("task",),
        simulates=True,
    ),
    # How good an expert is: success on seeds of its own, and its learning curve.
    Stage(
        name="card",
        version=1,
        request="acgd.experts.settings:CardRequest",
        function="acgd.experts.card:measure",
        per=("task",),
        reads=(Read("expert"),),
        wanted=True,
        simulates=True,
        priority=-10,
        results=("card.json",),
    ),
    # Q of the frozen expert.
    Stage(
        name="critic",
        version=1,
        request="acgd.critics.settings:CriticRequest",
        function="acgd.critics.fit:fit",
        per=("task",),
        reads=(Read("expert"),),
        simulates=True,
        priority=10,
    ),
    # How well a critic ranks actions, on episodes that its fit has not seen.
    Stage(
        name="quality",
        version=1,
        request="acgd.critics.settings:QualityRequest",
        function="acgd.critics.quality:measure",
        per=("task",),
        reads=(Read("expert"), Read("critic")),
        beside="critic",
        simulates=True,
        priority=-10,
        results=("quality.json",),
    ),
    # Demonstrations: successful episodes of the expert, with images.
    Stage(
        name="rollouts",
        version=1,
        request="acgd.collection.settings:RolloutsRequest",
        function="acgd.collection.demonstrations:collect",
        per=("task",),
        reads=(Read("expert"),),
        simulates=True,
        draws=True,
        priority=20,
        results=("summary.json",),
    ),
    # The network that turns an image into a vector.
    Stage(
        name="backbone",
        version=1,
        request="acgd.vision.settings:BackboneRequest",
        function="acgd.vision.train:train",
        reads=(Read("rollouts", optional=True),),
        priority=20,
    ),
    # The frozen backbone, applied once to every frame.
    Stage(
        name="features",
        version=1,
        request="acgd.vision.settings:FeaturesRequest",
        function="acgd.vision.encode:encode",
        per=("task",),
        reads=(Read("rollouts"), Read("backbone")),
        priority=20,
    ),
    # Stage (a) of Figure 2: action chunks to codes and back.
    Stage(
        name="codebook",
        version=1,
        request="acgd.students.settings:CodebookRequest",
        function="acgd.students.acgd.fit_codebook:fit",
        per=("seed",),
        reads=(Read("rollouts"), Read("backbone"), Read("features", optional=True)),
        results=("health.json",),
    ),
    # On-policy round r: episodes acted by a mixture of the student of round r - 1 and the expert.
    Stage(
        name="onpolicy",
        version=1,
        request="acgd.collection.settings:OnPolicyRequest",
        function="acgd.collection.onpolicy:collect",
        per=("seed", "round", "task"),
        first_round=1,
        reads=(Read("student", rounds="previous"), Read("expert"), Read("backbone"), Read("rollouts")),
        simulates=True,
        draws=True,
        results=("summary.json",),
    ),
    Stage(
        name="onpolicy_features",
        version=1,
        request="acgd.vision.settings:FeaturesRequest",
        function="acgd.vision.encode:encode",
        per=("seed", "round", "task"),
        first_round=1,
        reads=(Read("onpolicy", role="rollouts"), Read("backbone")),
    ),
    # Stage (b) of Figure 2: one student of all tasks.
    Stage(
        name="student",
        version=1,
        request="acgd.students.settings:StudentRequest",
        function="acgd.students.distil:distil",
        per=("seed", "round"),
        reads=(
            Read("rollouts"),
            Read("backbone"),
            Read("features", optional=True),
            Read("codebook", optional=True),
            Read("critic", optional=True),
            Read("quality", optional=True),
            Read("onpolicy", optional=True, rounds="so far"),
            Read("onpolicy_features", optional=True, rounds="so far"),
            Read("student", optional=True, rounds="previous"),
        ),
    ),
    # A student on held-out seeds, under one condition.
    Stage(
        name="evaluation",
        version=1,
        request="acgd.evaluation.settings:EvaluationRequest",
        function="acgd.evaluation.evaluate:evaluate",
        per=("seed", "condition"),
        reads=(
            Read("student", rounds="last"),
            Read("backbone"),
            Read("rollouts", optional=True),
            Read("expert", optional=True),
        ),
        wanted=True,
        simulates=True,
        draws=True,
        results=("summary.json",),
    ),
    # Films of a success and a failure per task.
    Stage(
        name="clips",
        version=1,
        request="acgd.evaluation.settings:ClipsRequest",
        function="acgd.evaluation.clips:clips",
        per=("seed",),
        reads=(Read("evaluation"),),
        wanted=True,
        simulates=True,
        draws=True,
        priority=-10,
    ),
    # What a policy that sees little, or all, does from the same starts.
    Stage(
        name="controls",
        version=1,
        request="acgd.evaluation.settings:ControlsRequest",
        function="acgd.evaluation.controls:controls",
        reads=(Read("rollouts"), Read("expert")),
        wanted=True,
        simulates=True,
        priority=-10,
        results=("summary.json",),
    ),
)

STAGES: dict[str, Stage] = {stage.name: stage for stage in _TABLE}
"""Name -> stage. Upstream stages stand before downstream ones, except that a round reads the student before it."""

REPORT = Stage(
    name="report",
    version=1,
    request="acgd.reports.settings:ReportRequest",
    function="acgd.reports.report:report",
)
"""One page for a study: it reads every artifact of every variant."""


def stage(name: str) -> Stage:
    """The row of that name, the report's included."""
    return REPORT if name == REPORT.name else STAGES[name]


def names() -> list[str]:
    """Of all stages, the report last."""
    return [*STAGES, REPORT.name]
