"""Experts: PPO that resumes, policies that are plain torch, cards that belong to their weights."""

import json
import shutil

import numpy as np
import pytest
import torch
from safetensors.torch import load_file

from acgd.config.expert import ExpertRequest, ExpertSettings, PPOConfig
from acgd.config.task import TaskConfig
from acgd.experts import ppo, train
from acgd.experts.policy import Expert
from acgd.tracking.metrics import Metrics
from acgd.tracking.progress import Progress

SMALL = PPOConfig(steps=96, envs=2, rollout_steps=16, batch=16, epochs=2, width=8, learning_rate=1e-3, learning_rate_end=1e-4)
REQUEST = ExpertRequest(
    task=TaskConfig(name="myo/pen-twirl"),
    expert=ExpertSettings(source="train", ppo=SMALL, evaluate_every=32, evaluation_episodes=2, checkpoint_every=32, card_episodes=2),
)


class Killed(Exception):
    """Stands for a kill."""


def run(folder, stop_after=None, monkeypatch=None):
    """Train in `folder`; with `stop_after`, die after so many checkpoints."""
    if stop_after is not None:
        left, save = [stop_after], ppo._save

        def saving(*arguments):
            save(*arguments)
            left[0] -= 1
            if left[0] == 0:
                raise Killed

        monkeypatch.setattr(ppo, "_save", saving)
    with open(folder / "progress.log", "w") as stream:
        return ppo.train_ppo(REQUEST, folder / "state", Metrics(folder / "metrics.jsonl"), Progress(stream))


def test_resumed_run_equals_an_uninterrupted_one(tmp_path, monkeypatch):
    whole, cut = tmp_path / "whole", tmp_path / "cut"
    whole.mkdir(), cut.mkdir()
    run(whole)
    with monkeypatch.context() as patch, pytest.raises(Killed):
        run(cut, 1, patch)
    assert (cut / "state/checkpoint.safetensors").is_file()
    run(cut)
    a, b = (load_file(folder / "state/checkpoint.safetensors") for folder in (whole, cut))
    assert a.keys() == b.keys() and all(torch.equal(a[name], b[name]) for name in a)
    best = [(folder / "state/best/policy.safetensors").read_bytes() for folder in (whole, cut)]
    assert best[0] == best[1]


def test_learning_rate_falls_over_the_whole_run():
    rate = ppo._LearningRate(SMALL)
    seen = []
    for rate.step in (0, 48, 96):
        seen.append(rate(0.0))
    assert seen == pytest.approx([1e-3, 5.5e-4, 1e-4])


def test_exported_expert_acts_like_the_trained_policy(tmp_path):
    from stable_baselines3 import PPO
    from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize

    env = ppo.StateOnly(REQUEST.task, SMALL, 0)
    venv = VecNormalize(DummyVecEnv([lambda: env]))
    venv.reset()
    for _ in range(20):
        venv.step(np.zeros((1, 39), np.float32))
    model = PPO("MlpPolicy", venv, n_steps=16, batch_size=16, policy_kwargs={"net_arch": [8, 8]}, device="cpu")
    raw = venv.get_original_obs()
    wanted = np.clip(model.predict(venv.normalize_obs(raw), deterministic=True)[0], -1, 1)
    expert = ppo.export(model, venv, {"gamma": 0.97})
    assert expert.mean(raw) == pytest.approx(wanted, abs=1e-5)
    expert.save(tmp_path)
    again = Expert.load(tmp_path)
    assert np.array_equal(again.mean(raw), expert.mean(raw)) and again.meta == expert.meta


def test_sampled_actions_stay_in_the_box_and_spread_around_the_mean():
    expert = Expert.random(5, 3, seed=1)
    state = np.zeros((4000, 5), np.float32)
    actions = expert.sample(state, np.random.default_rng(0))
    assert np.abs(actions).max() <= 1
    assert actions.std(0) == pytest.approx(np.exp(-1), abs=0.05)


@pytest.fixture
def entry(tmp_path, monkeypatch):
    """A copy of one zoo entry, in a zoo of its own."""
    monkeypatch.setattr(train, "ZOO", tmp_path)
    return shutil.copytree(train.Path(train.__file__).parents[2] / "zoo/myo-reach", tmp_path / "myo-reach")


def test_sound_card_passes(entry):
    assert train.check(entry)["task"] == "myo/reach"


def test_card_of_other_weights_is_refused_with_the_mend(entry):
    weights = entry / "policy.safetensors"
    content = bytearray(weights.read_bytes())
    content[-1] ^= 1
    weights.write_bytes(content)
    with pytest.raises(ValueError, match="not the card.*zoo card myo-reach"):
        train.check(entry)


def test_missing_entry_names_what_the_zoo_has(entry):
    with pytest.raises(FileNotFoundError, match="expert.source to train.*myo-reach"):
        train.check(entry.parent / "myo-pose")


def test_shipped_cards_belong_to_their_weights_and_hold_what_they_claim():
    folders = sorted(path.parent for path in train.ZOO.glob("*/card.json"))
    assert len(folders) >= 3
    for folder in folders:
        card = train.check(folder)
        final = card["success"]["final"]
        assert card["episodes"] >= 200 and final["low"] < final["rate"] == final["successes"] / card["episodes"]
        assert json.loads((folder / "request.json").read_text())["expert"]["ppo"] == card["settings"]
        assert sum(path.stat().st_size for path in folder.iterdir()) < 2e6
