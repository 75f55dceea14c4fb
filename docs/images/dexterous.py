"""Draws docs/images/dexterous.png: BiDex and OpDex as a student sees them, at a start and solved.

`python -m docs.images.dexterous`
"""

from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt

from acgd.tasks import registry
from acgd.tasks.settings import TaskConfig
from acgd.tasks.spec import TASKS
from tests.open_loop import SOLUTIONS, follow

SEED = 7
"""The start that is drawn."""
ORDER = [name for name, spec in TASKS.items() if spec.suite != "myo"]

figure, axes = plt.subplots(2, len(ORDER), figsize=(2 * len(ORDER), 4.4))
for (above, below), name in zip(axes.T, ORDER):
    above.imshow(registry.make(name).reset(seed=SEED)[0]["image"], interpolation="nearest")
    above.set_title(name, fontsize=9)
    env = registry.make(TaskConfig(name=name, start="nominal"), image_size=None)
    follow(env, SOLUTIONS[name])
    below.imshow(env.render(), interpolation="nearest")
for axis in axes.flat:
    axis.axis("off")
figure.tight_layout(pad=0.4)
figure.savefig(Path(__file__).with_suffix(".png"), dpi=110, metadata={"Software": None})
