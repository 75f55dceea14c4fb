"""Actions a second of an exported student at batch 1 on one core: `python -m benchmarks.table onnx`."""

import statistics
import tempfile
import time
from pathlib import Path

import numpy as np
import torch

from acgd.export.onnx.graph import INPUTS, MEMORY, Graph
from acgd.export.onnx.parity import Inputs
from acgd.export.onnx.write import export, session_of
from acgd.students.acgd.settings import ACGDConfig
from acgd.students.load import new_student
from acgd.students.settings import ActingConfig, ImitationConfig
from acgd.students.student import Sizes
from acgd.vision.privileged.backbone import Privileged
from benchmarks.row import Row

TASKS, TARGETS, IMAGE, PROPRIO, ACTIONS, ROWS = 3, 6, 84, 85, 39, 3
STEPS, WARMUP = 300, 20
LEAST = 100


@torch.no_grad()
def run() -> list[Row]:
    """Default student and default backbone, with image; times of the median step."""
    torch.manual_seed(0)
    backbone = Privileged(64, [TARGETS] * TASKS).eval()
    sizes = Sizes(backbone.dim, PROPRIO, ACTIONS, TASKS, owns_cnn=False)
    student = new_student(ACGDConfig(), ImitationConfig(), sizes).eval().requires_grad_(False)
    graph = Graph(backbone, student, ActingConfig(), [torch.zeros(1, backbone.dim)] * TASKS).eval()
    rng = np.random.default_rng(0)
    images = rng.integers(0, 256, (1, ROWS, IMAGE, IMAGE, 3), dtype=np.uint8)
    inputs = Inputs(images, np.zeros((1, ROWS, PROPRIO), np.float32), 0, np.zeros(ROWS, np.int64), None)
    with tempfile.TemporaryDirectory() as folder:
        export(graph, inputs, Path(folder) / "student.onnx")
        session = session_of(Path(folder) / "student.onnx")
    given = dict(zip(INPUTS, (images[0, :1], inputs.proprio[0, :1], np.zeros(1, np.int64), np.zeros(1, np.int64))))
    given |= {MEMORY + name: value.numpy() for name, value in graph.begin(1).items()}
    seconds = []
    for _ in range(STEPS):
        began = time.perf_counter()
        session.run(None, given)
        seconds.append(time.perf_counter() - began)
    rate = 1 / statistics.median(seconds[WARMUP:])
    return [
        Row(
            name="onnx/actions",
            value=rate,
            unit="actions/s",
            ratio=None,
            target=f"at least {LEAST} on one core",
            met=rate >= LEAST,
        )
    ]
