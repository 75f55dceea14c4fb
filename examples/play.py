"""Plays an exported student, without torch: python examples/play.py student.onnx [--episodes 25] [--task myo/reach]."""

import argparse
import json

import numpy as np
import onnxruntime

from acgd.simulate.seeds import SEEDS
from acgd.tasks import registry


def play(file, only=None, episodes=25):
    """Runs episodes on the seeds of evaluations. Returns task -> number of successes."""
    session = onnxruntime.InferenceSession(file, providers=["CPUExecutionProvider"])
    notes = {k: json.loads(v) for k, v in session.get_modelmeta().custom_metadata_map.items()}
    fed = {one.name: one for one in session.get_inputs()}
    kinds = {"tensor(float)": np.float32, "tensor(int64)": np.int64}
    outputs = [one.name.replace("next.", "memory.") for one in session.get_outputs()]
    successes = {}
    for number, task in enumerate(notes["tasks"]):
        if only not in (None, task):
            continue
        env = registry.make({"name": task, "start": notes["starts"][number]}, image_size=notes["image_size"])
        for seed in SEEDS.evaluation.take(episodes):
            observation, info = env.reset(seed=seed)
            if notes["goal"] == "vector":
                goal = np.zeros(fed["goal"].shape[1:], np.float32)
                goal[: len(env.goal_vector())] = env.goal_vector()
            else:  # as evaluations choose it
                goal = np.random.default_rng([seed, 2]).integers(max(notes["goals"][number], 1))
            given = {"task": np.array([number]), "goal": np.array([goal])}
            given |= {n: np.zeros((1, *f.shape[1:]), kinds[f.type]) for n, f in fed.items() if n.startswith("memory.")}
            done = False
            while not done:
                given |= {name: observation[name][None] for name in ("image", "proprio")}
                result = dict(zip(outputs, session.run(None, {name: given[name] for name in fed})))
                observation, _, terminated, truncated, info = env.step(result.pop("action")[0])
                given, done = given | result, terminated or truncated
            successes[task] = successes.get(task, 0) + info["success"]["final"]
        print(f"{task}: {successes[task]} of {episodes} episodes succeed")
    return successes


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("model")
    parser.add_argument("--task")
    parser.add_argument("--episodes", type=int, default=25)
    options = parser.parse_args()
    play(options.model, options.task, options.episodes)
