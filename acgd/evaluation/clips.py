"""The stage `clips`: films of an evaluation's episodes. Equal episodes give equal bytes."""

import subprocess
from pathlib import Path

import gymnasium
import numpy as np

from acgd.evaluation.episodes import Episode, read_actions
from acgd.evaluation.settings import ClipsRequest
from acgd.store.stage import Context, Inputs
from acgd.tasks import registry

SIZE = 252
"""Pixels per side. The frames are drawn at this size, since the policy's images are smaller."""
FRAMES_PER_S = 25
LAST_FRAME_S = 0.6
"""Duration of the last frame, which decides `final` success."""


def clips(request: ClipsRequest, inputs: Inputs, ctx: Context) -> None:
    """Films the recorded success and failure of each task, as far as the evaluation has them.

    Writes <task>-success.mp4 and <task>-failure.mp4.
    """
    recorded = read_actions(inputs["evaluation"] / "actions.safetensors")
    with ctx.progress(len(recorded), "filming") as bar:
        for task in request.tasks:
            episodes = [(episode, actions) for episode, actions in recorded if episode.label.task == task.name]
            if not episodes:
                continue
            start = task.model_copy(update={"start": episodes[0][0].label.start})
            env = registry.make(start, image_size=None)
            for episode, actions in episodes:
                outcome = "success" if episode.final else "failure"
                film(ctx.out / f"{task.name.replace('/', '-')}-{outcome}.mp4", env, episode, actions)
                bar.update(1)


def film(path: Path, env: gymnasium.Env, episode: Episode, actions: np.ndarray) -> None:
    """Repeats the episode from its seed with its actions (steps, A) and writes the frames as mp4.

    Raises RuntimeError if the outcome differs: the simulation is then not reproducible.
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
            f"{episode.label.task}, seed {episode.seed}: the simulation does not repeat. The recorded actions ended "
            f"with {info['success']}. Remake the evaluation on this machine."
        )
    rate = 1 / (every * env.control_step)
    write_mp4(path, np.stack(frames + [frames[-1]] * round(LAST_FRAME_S * rate)), rate)


def write_mp4(path: Path, frames: np.ndarray, frames_per_s: float) -> None:
    """Writes a H.264 film that browsers play. frames: (N, H, W, 3) uint8 with even H and W.

    One thread and no metadata make the bytes reproducible. Raises RuntimeError of an ffmpeg error.
    """
    from imageio_ffmpeg import get_ffmpeg_exe

    _, height, width, _ = frames.shape
    path.parent.mkdir(parents=True, exist_ok=True)
    source = ["-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{width}x{height}", "-r", f"{frames_per_s:g}", "-i", "-"]
    codec = ["-c:v", "libx264", "-preset", "veryfast", "-crf", "26", "-pix_fmt", "yuv420p", "-threads", "1"]
    plain = ["-map_metadata", "-1", "-fflags", "+bitexact", "-flags:v", "+bitexact", "-movflags", "+faststart"]
    command = [get_ffmpeg_exe(), "-nostdin", "-y", "-loglevel", "error", *source, *codec, *plain, str(path)]
    ffmpeg = subprocess.run(command, input=np.ascontiguousarray(frames).tobytes(), capture_output=True)
    if ffmpeg.returncode != 0:
        raise RuntimeError(f"ffmpeg could not write {path}: {ffmpeg.stderr.decode(errors='replace').strip()}")
