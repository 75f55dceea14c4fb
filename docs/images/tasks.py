"""Draws docs/images/tasks.png: every MyoDex task as a student sees it. `python -m docs.images.tasks`"""

from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from acgd.tasks import registry
from acgd.tasks.spec import TASKS

SEED = 3
"""The start that is drawn."""
STEPS = 4
"""Control steps of a resting hand before the picture."""

figure, axes = plt.subplots(2, 5, figsize=(10, 4.4))
order = [name for name, spec in TASKS.items() if spec.suite == "myo" and not name.endswith("-hard")]
for axis, name in zip(axes.flat, order + [f"{name}-hard" for name in order]):
    env = registry.make(name)
    env.reset(seed=SEED)
    for _ in range(STEPS):
        obs = env.step(np.full(39, -0.5))[0]
    axis.imshow(obs["image"], interpolation="nearest")
    axis.set_title(name, fontsize=9)
    axis.axis("off")
figure.tight_layout(pad=0.4)
figure.savefig(Path(__file__).with_suffix(".png"), dpi=110, metadata={"Software": None})
