"""Small made-up rollouts, features and critics as published artifacts, for tests and benchmarks of the students."""

import json
from pathlib import Path

import numpy as np
import torch

from acgd.nn.q_ensemble import Critic
from acgd.rollouts.store import write_group
from acgd.store.metrics import Metrics
from acgd.store.progress import Progress
from acgd.store.stage import Context
from acgd.students.settings import CodebookRequest, ImitationConfig, RoundsConfig, StudentRequest
from acgd.students.training_settings import TrainingConfig
from acgd.tasks.settings import TaskConfig

TASKS = ("myo/reach", "myo/obj-hold")
P, A, F = 7, 5, 6
STUDENTS = {
    "acgd": {
        "kind": "acgd",
        "chunk": 4,
        "history": 3,
        "groups": 2,
        "codes": 8,
        "width": 32,
        "heads": 2,
        "encoder_layers": 1,
        "decoder_layers": 1,
    },
    "act": {"kind": "act", "chunk": 4, "history": 3, "latent": 4, "width": 32, "heads": 2},
    "bc": {"kind": "bc", "width": 64},
    "bc_rnn": {"kind": "bc_rnn", "sequence": 4, "width": 64, "modes": 3},
    "chunk": {"kind": "chunk", "chunk": 4, "history": 3, "width": 32, "heads": 2},
}
"""Tiny students, one of each kind."""
TRAINING = {"bc": {"learning_rate": 1e-2}, "bc_rnn": {"learning_rate": 1e-2}}
"""Kinds that need other settings than the rest to learn the small dataset in a few steps."""
GUIDANCE = {"none": {"kind": "none"}, "critic": {"kind": "critic"}}


def rollouts(
    directory: Path,
    task: int,
    episodes: int = 10,
    length: int = 20,
    state: int = 9,
    images: bool = False,
    seed: int = 0,
) -> Path:
    """Episodes of unequal length. proprio[0] is t / 10, features[0] the sine of an angle that only the image shows."""
    rng = np.random.default_rng([seed, task])
    lengths = length - np.arange(episodes) % 4
    ends = np.cumsum(lengths)
    t = np.concatenate([np.arange(n) for n in lengths])
    angle = np.repeat(rng.uniform(-1, 1, episodes), lengths)
    proprio = rng.normal(size=(len(t), P)).astype(np.float32) * 0.1
    proprio[:, 0] = t / 10
    mean = np.stack([0.8 * np.sin(0.4 * t + j + angle + task) for j in range(A)], -1).astype(np.float32)
    arrays = {
        "proprio": proprio,
        "state": rng.normal(size=(len(t), state)).astype(np.float32),
        "mean_action": mean,
        "action": np.clip(mean + 0.1 * rng.normal(size=mean.shape), -1, 1).astype(np.float32),
        "goal": rng.normal(size=(episodes, 2 + task)).astype(np.float32),
        "episode_ends": ends.astype(np.int64),
        "seed": np.arange(episodes, dtype=np.int64),
    }
    if images:
        arrays["image"] = rng.integers(0, 256, (len(t), 32, 32, 3), dtype=np.uint8)
        arrays["final_image"] = rng.integers(0, 256, (episodes, 32, 32, 3), dtype=np.uint8)
    write_group(
        directory / "rollouts.zarr",
        arrays,
        {"task": TASKS[task], "reward_terms": [], "state_layout": {"everything": [0, state]}},
    )
    features = rng.normal(size=(len(t), F)).astype(np.float32) * 0.1
    features[:, 0] = angle
    final = rng.normal(size=(episodes, F)).astype(np.float32)
    write_group(directory / "features.zarr", {"image": features, "final_image": final}, {})
    return directory


def critic(directory: Path, state: int, actions: int = A, members: int = 2, width: int = 32, seed: int = 0) -> Path:
    """An untrained critic."""
    directory.mkdir(parents=True)
    made = Critic(state, actions, members, width, dueling=True, generator=torch.Generator().manual_seed(seed))
    made.spread.fill_(0.5)
    made.save(directory)
    return directory


def quality(directory: Path, low: float | None) -> Path:
    """The quality of a critic; `low` is the low end of its within-state rank interval."""
    directory.mkdir(parents=True)
    (directory / "quality.json").write_text(json.dumps({"within_state": {"low": low}}))
    return directory


def backbone(directory: Path, dim: int = 8) -> Path:
    """A backbone of kind `scratch`: a student without features has a CNN of that width."""
    directory.mkdir(parents=True)
    (directory / "backbone.json").write_text(json.dumps({"kind": "scratch", "dim": dim}))
    return directory


def codebook_request(
    seed: int = 0, training: dict | None = None, imitation: dict | None = None, **student
) -> CodebookRequest:
    """A tiny codebook on two tasks."""
    return CodebookRequest(
        tasks=[TaskConfig(name=name) for name in TASKS],
        imitation=ImitationConfig(**(imitation or {})),
        student=STUDENTS["acgd"] | {"codebook": {"training": _training(training)}} | student,
        seed=seed,
    )


def student_request(
    kind: str = "acgd",
    guidance: dict | None = None,
    training: dict | None = None,
    imitation: dict | None = None,
    seed: int = 0,
    rounds: dict | None = None,
    round: int = 0,
    **student,
) -> StudentRequest:
    """A tiny student on two tasks."""
    return StudentRequest(
        tasks=[TaskConfig(name=name) for name in TASKS],
        imitation=ImitationConfig(**(imitation or {})),
        student=STUDENTS[kind] | student,
        training=_training(training),
        guidance=guidance or {"kind": "none"},
        rounds=None if rounds is None else RoundsConfig(**rounds),
        round=round,
        seed=seed,
    )


def context(directory: Path) -> Context:
    """A context that writes below `directory`, its progress unseen."""
    out, state = directory / "out", directory / "state"
    out.mkdir(parents=True, exist_ok=True)
    state.mkdir(exist_ok=True)
    return Context(out, state, Metrics(out / "metrics.jsonl"), Progress(open("/dev/null", "w")), torch.device("cpu"))


def _training(fields: dict | None) -> TrainingConfig:
    small = {"steps": 6, "batch": 16, "warmup": 2, "validate_every": 2, "checkpoint_every": 3}
    return TrainingConfig(**small | (fields or {}))
