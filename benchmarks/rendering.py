"""Frames per second at 84 px in one thread, against MuJoCo's defaults: `python -m benchmarks.rendering`."""

import statistics
import time
from collections.abc import Callable

import mujoco
import numpy as np

from acgd.tasks import registry
from acgd.tasks.rendering import gl
from acgd.tasks.rendering.camera import Camera
from acgd.tasks.rendering.renderer import Renderer
from benchmarks.row import Row

SIZE = 84
FRAMES = 200
DEFAULT_FRAMES = 3
LEAST_RATE, LEAST_RATIO = 400.0, 60.0
TASKS = ("myo/key-turn", "myo/obj-hold", "myo/pen-twirl", "myo/pose", "myo/reach")
"""Tasks with different pictures. The hard versions look the same."""


def run() -> list[Row]:
    """One row per task: rate of the median frame, and its ratio to the rate of MuJoCo's defaults."""
    return [_measure(task) for task in TASKS]


def _measure(task: str) -> Row:
    env = registry.make(task, image_size=None)
    env.reset(seed=0)
    camera = env.task.code().CAMERA
    ours = Renderer(env.model, camera=camera, size=SIZE)
    default = _default(env.model, env.data, camera)
    _, slow = _seconds(default, DEFAULT_FRAMES)
    wall, fast = _seconds(lambda: ours.render(env.data), FRAMES)
    env.close()
    return Row(
        name=f"rendering/{task}",
        value=1 / wall,
        unit="frames/s",
        ratio=slow / fast,
        target=f">= {LEAST_RATE:.0f} frames/s and >= {LEAST_RATIO:.0f} times the default",
        met=1 / wall >= LEAST_RATE and slow / fast >= LEAST_RATIO,
    )


def _default(model: mujoco.MjModel, data: mujoco.MjData, camera: Camera) -> Callable[[], np.ndarray]:
    """The renderer of mujoco.Renderer(model, SIZE, SIZE) in the project's OpenGL context.

    mujoco.Renderer would need MUJOCO_GL at import.
    """
    view, option = camera.build(), mujoco.MjvOption()
    scene, viewport = mujoco.MjvScene(model, maxgeom=10_000), mujoco.MjrRect(0, 0, SIZE, SIZE)
    with gl.context().as_current():
        target = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_150)

    def render() -> np.ndarray:
        image = np.empty((SIZE, SIZE, 3), np.uint8)
        mujoco.mjv_updateScene(model, data, option, None, view, mujoco.mjtCatBit.mjCAT_ALL, scene)
        with gl.context().as_current():
            mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, target)
            mujoco.mjr_render(viewport, scene, target)
            mujoco.mjr_readPixels(image, None, viewport, target)
        return np.flipud(image)

    return render


def _seconds(render: Callable[[], np.ndarray], frames: int) -> tuple[float, float]:
    """Median wall time and processor time of a frame in seconds, without the first frame, which uploads meshes.

    The ratio uses processor times, because other processes interrupt slow frames more often than fast ones.
    """
    render()
    wall, processor = [], []
    for _ in range(frames):
        start, used = time.perf_counter(), time.process_time()
        render()
        wall.append(time.perf_counter() - start)
        processor.append(time.process_time() - used)
    return statistics.median(wall), statistics.median(processor)


def main() -> None:
    print(f"{'task':<28}{'frames/s':>10}{'ms':>8}{'x default':>11}  met")
    for row in run():
        rate = row["value"]
        print(f"{row['name']:<28}{rate:>10.0f}{1e3 / rate:>8.2f}{row['ratio']:>11.0f}  {'yes' if row['met'] else 'NO'}")


if __name__ == "__main__":
    main()
