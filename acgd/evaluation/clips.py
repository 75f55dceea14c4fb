"""The stage `clips`: short films of an evaluation's episodes, the same bytes for the same episode."""

import subprocess
from pathlib import Path

import gymnasium
import numpy as np

from acgd.evaluation.episodes import Episode, read_actions
from acgd.evaluation.settings import ClipsRequest
from acgd.store.stage import Context, Inputs
from acgd.tasks import registry

SIZE = 252
"""Pixels a side; drawn anew at this size, since the policy's own images are small."""
FRAMES_PER_S = 25
LAST_FRAME_S = 0.6
"""How long the last frame, on which `final` success is decided, stays."""


def clips(request: ClipsRequest, inputs: Inputs, ctx: Context) -> None:
    """Films the first success and the first failure of each task, where there is one.

    Writes <task>-success.mp4 and <task>-failure.mp4.
    """
    recorded = read_actions(inputs["evaluation"] / "actions.safetensors")
    with ctx.progress(len(recorded), "filming") as bar:
        for task in request.tasks:
            of_task = [(episode, actions) for episode, actions in recorded if episode.label.task == task.name]
            if not of_task:
                continue
            start = task.model_copy(update={"start": of_task[0][0].label.start})
            env = registry.make(start, image_size=None)
            for episode, actions in of_task:
                outcome = "success" if episode.final else "failure"
                film(ctx.out / f"{task.name.replace('/', '-')}-{outcome}.mp4", env, episode, actions)
                bar.update(1)


def film(path: Path, env: gymnasium.Env, episode: Episode, actions: np.ndarray) -> None:
    """Runs the episode again from its seed with its actions (steps, A), and writes it as mp4.

    Raises RuntimeError if it ends differently, since then the simulation does not repeat and no result here would.
    """
    every = max(1, round(1 / (FRAMES_PER_S * env.control_step)))
    env.reset(seed=episode.seed)
    frames = [env.render(SIZE)]
    for step, action in enumerate(actions, start=1):
        *_, info = env.step(action)
        if step % every == 0 or step == len(actions):
            frames.append(env.render(SIZE))
    if info["success"] != {"final": episode.final, "held": episode.held, "once": episode.once}:
        raise RuntimeError(
            f"{episode.label.task}, seed {episode.seed}: the recorded actions ended as {info['success']} this time; "
            "the simulation does not repeat"
        )
    rate = 1 / (every * env.control_step)
    write_mp4(path, np.stack(frames + [frames[-1]] * round(LAST_FRAME_S * rate)), rate)


def write_mp4(path: Path, frames: np.ndarray, frames_per_s: float) -> None:
    """Writes H.264 that browsers play. One thread and no metadata make the bytes repeat.

    frames: (N, H, W, 3) uint8 with even H and W.
    """
    from imageio_ffmpeg import get_ffmpeg_exe

    _, height, width, _ = frames.shape
    path.parent.mkdir(parents=True, exist_ok=True)
    source = ["-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{width}x{height}", "-r", f"{frames_per_s:g}", "-i", "-"]
    codec = ["-c:v", "libx264", "-preset", "veryfast", "-crf", "26", "-pix_fmt", "yuv420p", "-threads", "1"]
    plain = ["-map_metadata", "-1", "-fflags", "+bitexact", "-flags:v", "+bitexact", "-movflags", "+faststart"]
    command = [get_ffmpeg_exe(), "-nostdin", "-y", "-loglevel", "error", *source, *codec, *plain, str(path)]
    done = subprocess.run(command, input=np.ascontiguousarray(frames).tobytes(), capture_output=True)
    if done.returncode != 0:
        raise RuntimeError(f"ffmpeg could not write {path}: {done.stderr.decode(errors='replace').strip()}")
