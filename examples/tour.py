"""A task, an expert, a film, a dataset and a student: python examples/tour.py [film.mp4] [dataset] [student.onnx]."""

import sys
from pathlib import Path

import gymnasium
import imageio_ffmpeg
import numpy as np

import acgd.tasks  # noqa: F401  (Gymnasium then knows the tasks)
from acgd.experts import zoo
from acgd.experts.policy import Expert
from acgd.export.replay import read, replay

film, *given = sys.argv[1:] or ["tour.mp4"]

env = gymnasium.make("acgd/myo-key-turn-v0", image_size=84)
expert = Expert.load(zoo.folder("myo/key-turn"))
observation, info = env.reset(seed=0)
frames, done = [], False
while not done:
    action = expert.mean(observation["state"][None])[0]
    observation, reward, terminated, truncated, info = env.step(action)
    frames.append(env.unwrapped.render(256))
    done = terminated or truncated
print(f"the expert turned the key: {info['success']['final']}")

writer = imageio_ffmpeg.write_frames(film, (256, 256), fps=50)
writer.send(None)
for frame in frames:
    writer.send(np.ascontiguousarray(frame))
writer.close()
print(f"the film: {film}")

for folder in (Path(one) for one in given if Path(one).is_dir()):
    episode = next(read(folder))
    print(f"{folder}: {episode.task}, {', '.join(f'{n} {c.shape}' for n, c in episode.columns.items())}")
    print(f"its first episode replayed succeeds: {next(replay(read(folder))).replayed}")

for model in (one for one in given if one.endswith(".onnx")):
    from play import play

    play(model, episodes=1)
