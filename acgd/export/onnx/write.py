"""A student as one ONNX file. The export fails where the file differs from the student."""

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import onnx
import torch
from torch import Tensor

from acgd.export.artifacts import downstream, manifest, upstream
from acgd.export.onnx.graph import INPUTS, MEMORY, NEXT, Graph
from acgd.export.onnx.parity import TIE, Inputs, Parity, measure, random_inputs
from acgd.export.onnx.settings import OnnxSettings
from acgd.export.recording import Recordings
from acgd.rollouts.dataset import Demonstrations
from acgd.rollouts.store import read_rows
from acgd.store.store import ArtifactError
from acgd.students.load import load_student, policy_of
from acgd.students.settings import ActingConfig
from acgd.students.student import Student
from acgd.tasks.spec import TASKS
from acgd.vision.backbones import load as load_backbone

FILE = "student.onnx"
BOUND = 1e-5
"""Largest allowed difference of an action to the student."""
MEMORY_BOUND = 1e-4
"""Largest allowed difference of the memory. Rounding of features is 5e-7. A normaliser with a small standard deviation
and an LSTM make 1e-5 of it, although actions then differ by 6e-7.
"""
OPSET, IR_VERSION = 18, 10
"""Versions that onnxruntime 1.20 reads."""
CHECKED_STEPS, CHECKED_ROWS = 40, 3
EXAMPLE_ROWS = 2


@torch.no_grad()
def write(settings: OnnxSettings, artifacts: Sequence[Path], folder: Path) -> str:
    """Writes student.onnx. ArtifactError where it differs from the student by more than the bounds."""
    if len(artifacts) != 1:
        raise ArtifactError(
            f"the name stands for {len(artifacts)} students: name one, such as results/<study>/<variant>/seed-0/student"
        )
    (artifact,) = artifacts
    backbones, recordings = upstream(artifact, "backbone"), _recordings(artifact)
    if not backbones:
        raise ArtifactError(
            f"the backbone of {artifact} is no longer in the store: run the workflow, which makes it anew"
        )
    cpu = torch.device("cpu")
    student = load_student(artifact, settings.weights, cpu).requires_grad_(False)
    backbone = None if student.sizes.owns_cnn else load_backbone(backbones[0], cpu)
    acting = settings.acting or _acting(artifact)
    images = goals = None
    if student.imitation.goal in ("own", "any"):
        images = [one.demonstrations.arrays["final_image"][: settings.goals] for one in recordings]
        goals = [torch.from_numpy(each) if backbone is None else backbone(torch.from_numpy(each)) for each in images]
    graph = Graph(backbone, student, acting, goals).eval()
    inputs = [
        _recorded(one, place, images[place] if images else None, student.sizes.goal)
        for place, one in enumerate(recordings)
    ]
    rng = np.random.default_rng(0)
    inputs += [random_inputs(one, rng) for one in inputs]
    tasks = json.loads((artifact / "student.json").read_text())["tasks"]
    policy = policy_of(student, backbone, acting, tasks=tasks, rows=CHECKED_ROWS)
    _check(measure(None, graph, policy, inputs), student.settings.kind)
    export(graph, inputs[0], folder / FILE)
    _describe(folder / FILE, artifact, tasks, graph, student.imitation.goal, acting, recordings)
    parity = measure(session_of(folder / FILE), graph, policy, inputs)
    _check(parity, student.settings.kind)
    return USE.format(
        goals=GOALS[student.imitation.goal],
        memory=_rows(graph),
        acting=f"Chunks become actions by `{acting.mode}`, eta {acting.eta}. " if _plans_chunks(student) else "",
        **{f"{name}_difference": getattr(parity, name) for name in ("action", "memory")},
        steps=parity.steps,
        ties=parity.ties,
        tie=TIE,
    )


def session_of(file: Path):
    """An onnxruntime session on one core."""
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    return onnxruntime.InferenceSession(str(file), options, providers=["CPUExecutionProvider"])


def _recordings(artifact: Path) -> list[Recordings]:
    """The demonstrations of each of the student's tasks, in their order."""
    recordings = [Recordings.load(folder) for folder in upstream(artifact, "rollouts")]
    if len(recordings) < len(manifest(artifact)["inputs"]["rollouts"]):
        raise ArtifactError(
            f"rollouts that {artifact} was trained on are no longer in the store. Its goal images and the inputs of "
            "its check are in them: run the workflow, which makes them anew"
        )
    return recordings


def _acting(artifact: Path) -> ActingConfig:
    """The setting of the student's first evaluation in the store, else the default."""
    for evaluation in downstream(artifact, "evaluation", "student"):
        return ActingConfig(**manifest(evaluation)["request"]["acting"])
    return ActingConfig()


def _recorded(recordings: Recordings, place: int, goal_images: np.ndarray | None, goal_size: int) -> Inputs:
    """The first steps of a few demonstrations of the task number `place`.

    goal_images (N, H, W, 3) of a student with goal images. goal_size: G of a student with commanded goals, else 0.
    """
    demos = recordings.demonstrations
    rows = np.arange(CHECKED_ROWS) % len(demos.episode_ends)
    steps = int(min(CHECKED_STEPS, demos.lengths.min()))
    starts = demos.episode_starts[rows]
    path = recordings.folder / "rollouts.zarr"
    images = np.stack([read_rows(path, "image", int(start), int(start) + steps) for start in starts], 1)
    proprio = np.stack([demos.arrays["proprio"][start : start + steps] for start in starts], 1)
    if goal_size:
        commanded = Demonstrations.load(recordings.folder, ["goal"]).arrays["goal"][rows]
        padded = np.pad(commanded, ((0, 0), (0, goal_size - commanded.shape[1])))
        return Inputs(images, proprio, place, padded, commanded)
    if goal_images is None:
        return Inputs(images, proprio, place, np.zeros_like(rows), None)
    numbers = rows % len(goal_images)
    return Inputs(images, proprio, place, numbers, goal_images[numbers])


def export(graph: Graph, inputs: Inputs, file: Path) -> None:
    """Writes the model without metadata. inputs: at least EXAMPLE_ROWS episodes, whose first step is the example.

    Raises ArtifactError where the model is for that number of episodes only: torch fixes it without a warning where
    Python code reads a size as a number, for example by `len`.
    """
    rows = EXAMPLE_ROWS
    task, goal = torch.full((rows,), inputs.task), torch.from_numpy(inputs.goals[:rows])
    seen = [torch.from_numpy(value[0, :rows]) for value in (inputs.images, inputs.proprio)]
    memory: list[Tensor] = list(graph.begin(rows).values())
    batch = torch.export.Dim("batch", min=1)
    torch.onnx.export(
        graph,
        (*seen, task, goal, *memory),
        file,
        dynamo=True,
        external_data=False,
        optimize=True,
        verbose=False,
        opset_version=OPSET,
        input_names=[*INPUTS, *(MEMORY + name for name in graph.names)],
        output_names=["action", *(NEXT + name for name in graph.names)],
        dynamic_shapes=({0: batch}, {0: batch}, {0: batch}, {0: batch}, tuple({0: batch} for _ in memory)),
    )
    inputs_of_model = onnx.load(file).graph.input
    if fixed := [one.name for one in inputs_of_model if not one.type.tensor_type.shape.dim[0].dim_param]:
        raise ArtifactError(f"the model's inputs {', '.join(fixed)} have a fixed number of episodes, {rows}")


def _describe(
    file: Path,
    artifact: Path,
    tasks: list[str],
    graph: Graph,
    goal: str,
    acting: ActingConfig,
    recordings: list[Recordings],
) -> None:
    """Writes the metadata that a user of the model needs into the model. goal: `imitation.goal`."""
    model = onnx.load(file)
    model.ir_version = IR_VERSION
    notes = {
        "tasks": tasks,
        "starts": [one.task.start for one in recordings],
        "horizons": [TASKS[name].horizon for name in tasks],
        "goal": goal,
        "goals": [0] * len(tasks) if graph.counts is None else graph.counts.tolist(),
        "image_size": recordings[0].image_size,
        "acting": acting.model_dump(),
        "artifact": artifact.resolve().name,
    }
    for name, value in notes.items():
        model.metadata_props.add(key=name, value=json.dumps(value))
    onnx.checker.check_model(model)
    onnx.save(model, file)


def _check(parity: Parity, kind: str) -> None:
    if parity.policy > BOUND:
        raise ArtifactError(
            f"a student of kind {kind} acts otherwise than by its chunks (difference {parity.policy:.1e}): "
            "its kind must offer `stepping` (acgd/export/onnx/stepping.py)"
        )
    if parity.action > BOUND or parity.memory > MEMORY_BOUND or not parity.steps:
        raise ArtifactError(
            f"the model differs from the student by more than {BOUND} in actions or {MEMORY_BOUND} in the memory, "
            f"or no step counts: {parity}"
        )


def _plans_chunks(student: Student) -> bool:
    """Whether the setting `acting` matters."""
    return student.settings.chunk > 1 and not student.settings.recurrent


def _rows(graph: Graph) -> str:
    """Rows of the memory in the card's table."""
    rows = []
    for name, (shape, kind) in graph.memory.items():
        sizes = f"({', '.join(map(str, ('B', *shape)))}{'' if shape else ','})"
        rows.append(f"| `{MEMORY}{name}` | {sizes} {str(kind).removeprefix('torch.')} | memory |")
    return "\n".join(rows)


_IMAGES = "| `goal` | (B,) int64 | number of one of the task's goal images |\n"
GOALS = {
    "own": _IMAGES,
    "any": _IMAGES,
    "vector": "| `goal` | (B, G) float32 | commanded goal of the episode, padded with zeros |\n",
    "off": "",
}
"""`imitation.goal` -> rows of the card's table."""

USE = """\
`student.onnx` holds the whole student: backbone, normaliser, networks, and the goal images of its training where it
has goal images. It runs without torch.

| input | shape | what |
|---|---|---|
| `image` | (B, H, W, 3) uint8 | for any number B of episodes in lockstep |
| `proprio` | (B, P) float32 | |
| `task` | (B,) int64 | number of the task |
{goals}{memory}

The memory is zero before an episode's first step. Outputs are `action` (B, A) in [-1, 1] and the next memory, with
`next.` in place of `memory.`. The file has no inputs that the student does not use. {acting}The file's metadata are the
tasks' names, starts and time limits, the kind of goal (`imitation.goal`), the numbers of goal images and the size of
the image.

Largest difference to the student in torch, on recorded and random inputs: actions {action_difference:.1e}, memory
{memory_difference:.1e}, over {steps} steps. {ties} steps are left out: their two likeliest choices lie within
{tie:.0e} of each other.

Run it in the simulator: `python examples/play.py <this folder>/student.onnx`.
"""
