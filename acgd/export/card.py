"""The card of an export: README.md, whose first lines hubs read."""

import json
import platform
from collections.abc import Sequence
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from acgd.export.artifacts import downstream, manifest, upstream
from acgd.settings import Section

PACKAGES = ("mujoco", "myosuite", "myo-sim", "gymnasium-robotics", "torch", "zarr")
HEADS = {
    "lerobot": "task_categories:\n- robotics\ntags:\n- LeRobot\n- acgd\n"
    "configs:\n- config_name: default\n  data_files: data/*/*.parquet\n",
    "onnx": "tags:\n- robotics\n- onnx\n- acgd\n",
}
"""Format -> lines that a hub reads besides the licence."""


def write_card(folder: Path, settings: Section, artifacts: Sequence[Path], use: str, command: str) -> None:
    """Writes README.md: content, origin and use of the export."""
    student = manifest(artifacts[0])["stage"] == "student"
    lines = [
        "---",
        "license: apache-2.0",
        HEADS.get(settings.kind, "tags:\n- robotics\n- acgd\n").rstrip("\n"),
        "---",
        "",
        f"# {'A student' if student else 'Episodes'} of ACGD",
        "",
        use,
        "## Where it comes from",
        "",
        *(_student(artifacts[0]) if student else _rollouts(artifacts)),
        "",
        "## How it was made",
        "",
        f"    {command}",
        "",
        f"Settings of the format: `{settings.model_dump_json()}`. SHA256SUMS has the checksum of every file. Packages: "
        f"{', '.join(_versions())}. Python {platform.python_version()}.",
        "",
        "Licence: Apache-2.0, as that of MyoSuite, whose models the MyoDex tasks are. The method is that of Srinivasan "
        "et al., Asymmetric Critic Guided Distillation; see CITATION.cff of the project.",
        "",
    ]
    (folder / "README.md").write_text("\n".join(lines), encoding="utf-8")


def _rollouts(artifacts: Sequence[Path]) -> list[str]:
    rows = ["| task | start | episodes | frames | seeds | attempts that succeeded | acting | expert | artifact |"]
    rows.append("|---|---|---|---|---|---|---|---|---|")
    for folder in artifacts:
        made, summary = manifest(folder), json.loads((folder / "summary.json").read_text())
        task, rollouts = made["request"]["task"], made["request"].get("rollouts", {})
        episodes = summary.get("demonstrations", summary.get("episodes"))
        acting = f"{rollouts['acting']}, noise {rollouts['noise']}" if rollouts else "student and expert in turns"
        cells = [task["name"], task["start"], episodes, summary.get("frames", summary["environment_steps"])]
        cells += [_seeds(folder), f"{summary['success']:.3f}", acting, _expert(folder), f"`{folder.resolve().name}`"]
        rows.append(f"| {' | '.join(map(str, cells))} |")
    return rows


def _seeds(folder: Path) -> str:
    """First and last seed."""
    from acgd.rollouts.store import read_group

    seeds = read_group(folder / "rollouts.zarr", ["seed"])["seed"]
    return f"{seeds.min()} to {seeds.max()}"


def _expert(folder: Path) -> str:
    """Learner and success of the expert, from its card; the expert's key where the store has no card."""
    for expert in upstream(folder, "expert"):
        for card in downstream(expert, "card", "expert"):
            content = json.loads((card / "card.json").read_text())
            final = content["success"]["final"]
            rate = f"{final['rate']:.3f} [{final['low']:.3f}, {final['high']:.3f}] of {content['episodes']}"
            return f"{content['algorithm']}, {content['steps']} steps, success {rate}"
    return f"`{manifest(folder)['inputs']['expert']}`"


def _student(folder: Path) -> list[str]:
    meta, made = json.loads((folder / "student.json").read_text()), manifest(folder)
    lines = [
        f"Kind `{meta['kind']}`, guidance `{made['request']['guidance']['kind']}`, round {meta['round']}, training "
        f"seed {meta['seed']}, artifact `{folder.resolve().name}`. Its tasks, by number: "
        + ", ".join(f"{place} {name}" for place, name in enumerate(meta["tasks"]))
        + ".",
        "",
        "It was trained on:",
        "",
        *_rollouts(upstream(folder, "rollouts")),
        "",
        "Success (`final`: solved at the last step), with 95 % intervals:",
        "",
        "| task | condition | episodes | success | interval |",
        "|---|---|---|---|---|",
    ]
    rows = [_row(row) for folder in downstream(folder, "evaluation", "student") for row in _final(folder)]
    return [
        *lines,
        *(rows or ["| not evaluated | | | | |"]),
        "",
        f"Settings: `{json.dumps(made['request']['student'])}`.",
    ]


def _final(folder: Path) -> list[dict[str, Any]]:
    rows = json.loads((folder / "summary.json").read_text())["success"]
    return [row for row in rows if row["rule"] == "final"]


def _row(row: dict[str, Any]) -> str:
    condition = f"goal {row['goal']}, image {row['image_features']}, start {row['start']}"
    interval = f"{row['low']:.2f} to {row['high']:.2f}"
    return f"| {row['task']} | {condition} | {row['episodes']} | {row['rate']:.2f} | {interval} |"


def _versions() -> list[str]:
    named = []
    for name in PACKAGES:
        try:
            named.append(f"{name} {version(name)}")
        except PackageNotFoundError:
            continue
    return named
