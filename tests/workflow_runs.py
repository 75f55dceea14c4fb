"""Snakemake in a folder of its own, with the miniature study unless another is named."""

import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]
STUDY = ROOT / "tests/miniature.yaml"


def snakemake(root=ROOT, study=STUDY):
    """The command, with the Snakefile and the package of `root`."""
    program = str(Path(sys.executable).with_name("snakemake"))
    return [program, "--snakefile", str(root / "workflow/Snakefile"), "--configfile", str(study), "--cores", "2"]


def workflow(folder, *arguments, root=ROOT, study=STUDY):
    """What a run in `folder` printed; it must end well."""
    environment = {**os.environ, "PYTHONPATH": str(root)}
    command = [*snakemake(root, study), *arguments]
    run = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True)
    assert run.returncode == 0, run.stdout[-5000:] + run.stderr[-5000:]
    return run.stdout + run.stderr
