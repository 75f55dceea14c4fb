"""Quality of a critic on held-out episodes. The headline is the rank correlation over actions of one state.

Reasons for this measure: docs/method.md, "Quality of a critic".
"""

import csv
import json
import math
from pathlib import Path

import numpy as np
import torch
from scipy import stats

from acgd.critics.gather import Visit, branches, candidates, rollouts
from acgd.critics.perturbations import Kind
from acgd.critics.ranks import rank_correlations
from acgd.critics.settings import QualityRequest
from acgd.critics.simulated import lockstep
from acgd.critics.transitions import Transitions
from acgd.experts.policy import Expert
from acgd.nn.q_ensemble import Critic
from acgd.simulate.seeds import SEEDS
from acgd.store.stage import Context, Inputs
from acgd.tasks.spec import TASKS

VISIT_RATE = 0.25
CONFIDENCE = 0.95
STREAM = 1
"""Second entropy of the generator that draws states and candidates; the first is the section's seed."""


def measure(request: QualityRequest, inputs: Inputs, ctx: Context) -> None:
    """{expert, critic} -> quality.json, and within_state.csv with Q and return of each candidate.

    Returns sum `tail` simulated steps, past the time limit if needed.
    """
    quality, limit = request.quality, TASKS[request.task.name].horizon
    expert, critic = Expert.load(inputs["expert"]), Critic.load(inputs["critic"]).to(ctx.device)
    gamma, lock = expert.meta["gamma"], lockstep(request.task, expert)
    rng = np.random.default_rng([quality.seed, STREAM])
    with ctx.progress(quality.states * (limit + quality.tail), "quality: held-out rollouts, steps at most") as bar:
        data, visits, kinds = rollouts(
            lock,
            expert,
            quality.perturbation,
            SEEDS.critic_quality,
            limit=limit,
            extra_steps=quality.tail,
            episodes=quality.states,
            visit_rate=VISIT_RATE,
            seed=quality.seed,
            bar=bar,
        )
    chosen = one_per_episode(visits, rng)
    actions, sources = candidates(expert, np.stack([visit.state for visit in chosen]), quality.candidates, rng)
    steps = actions.shape[0] * actions.shape[1] * quality.tail
    with ctx.progress(steps, "quality: candidate actions, steps at most") as bar:
        branch_data = branches(lock, expert, chosen, actions, quality.tail, bar)
    first_rows = branch_data.starts
    returns = discounted(branch_data, gamma, quality.tail)[first_rows].reshape(actions.shape[:2])
    q = _values(critic, branch_data.state[first_rows], branch_data.action[first_rows]).mean(0).reshape(returns.shape)
    near = [k for k, source in enumerate(sources) if source != "uniform"]
    spread = float(critic.spread)
    content = {
        "bellman_error": bellman_error(critic, data, gamma),
        "rank_correlation_monte_carlo": _monte_carlo(critic, data, kinds, limit, gamma, quality.tail),
        "within_state": interval(rank_correlations(q, returns)) | {"candidates": quality.candidates},
        "within_state_near": interval(rank_correlations(q[:, near], returns[:, near])) | {"candidates": len(near)},
        "prefers_expert": _preferences(sources, q, returns),
        "gain_of_best_candidate": {
            "critic": float((returns[np.arange(len(returns)), q.argmax(1)] - returns[:, 0]).mean() / spread),
            "simulator": float((returns.max(1) - returns[:, 0]).mean() / spread),
        },
        "spread": spread,
        "tail": quality.tail,
        "cut_off_weight": gamma**quality.tail,
        "simulator_steps": len(data) + len(branch_data),
    }
    _write(ctx.out / "within_state.csv", sources, q, returns)
    (ctx.out / "quality.json").write_text(json.dumps(content, indent=1, sort_keys=True) + "\n")


def one_per_episode(visits: list[Visit], rng: np.random.Generator) -> list[Visit]:
    """One random visited state of each episode, so that the states are independent.

    The first state of an episode is chosen only where it is the episode's one visit.
    """
    by_episode: dict[int, list[Visit]] = {}
    for visit in visits:
        by_episode.setdefault(visit.episode, []).append(visit)
    return [
        episode_visits[rng.integers(1, len(episode_visits))] if len(episode_visits) > 1 else episode_visits[0]
        for episode_visits in by_episode.values()
    ]


def discounted(data: Transitions, gamma: float, steps: int) -> np.ndarray:
    """(N,) float64: discounted sum of the rewards of `steps` rows from each row on, fewer where its episode ends.

    All returns have the same length. A tail that shrinks towards the end of an episode would encode the time.
    """
    end = np.repeat(data.ends, data.ends - data.starts)
    returns, rows = np.zeros(len(data)), np.arange(len(data))
    for j in range(steps):
        rows = rows[rows + j < end[rows]]
        returns[rows] += gamma**j * data.reward[rows + j].astype(np.float64)
    return returns


def interval(values: np.ndarray) -> dict[str, float | int]:
    """Mean over states and its 95% interval by Student's t.

    values: (V,), nan for states whose returns are all equal; these are left out. With fewer than two states the
    interval is [-1, 1].
    """
    values = values[~np.isnan(values)]
    if len(values) < 2:
        return {"mean": float(values.sum()), "low": -1.0, "high": 1.0, "states": len(values)}
    half = float(stats.t.ppf(0.5 + CONFIDENCE / 2, len(values) - 1) * values.std(ddof=1) / math.sqrt(len(values)))
    return {
        "mean": float(values.mean()),
        "low": float(values.mean()) - half,
        "high": float(values.mean()) + half,
        "states": len(values),
    }


def bellman_error(critic: Critic, data: Transitions, gamma: float) -> float:
    """RMS of Q(s, a) - y, y = r + gamma (1 - terminated) Q(s', pi_E(s')), divided by the standard deviation of y."""
    target = data.reward + gamma * ~data.terminated * _values(critic, data.next_state, data.next_action).mean(0)
    error = _values(critic, data.state, data.action).mean(0) - target
    return float(np.sqrt((error**2).mean()) / max(target.std(), 1e-12))


def _monte_carlo(critic: Critic, data: Transitions, kinds: list[Kind], limit: int, gamma: float, tail: int) -> float:
    """Spearman's correlation between Q and returns, over the states of clean episodes within the time limit.

    0 where all returns are equal.
    """
    returns = discounted(data, gamma, tail)
    rows = np.concatenate(
        [
            np.arange(start, min(end, start + limit))
            for start, end, (name, _) in zip(data.starts, data.ends, kinds)
            if name == "clean"
        ]
    )
    q = _values(critic, data.state[rows], data.action[rows]).mean(0)
    if np.ptp(q) == 0 or np.ptp(returns[rows]) == 0:
        return 0.0
    return float(stats.spearmanr(q, returns[rows]).statistic)


def _preferences(sources: list[str], q: np.ndarray, returns: np.ndarray) -> dict[str, dict[str, float]]:
    """Source -> share of candidates that are worse than the expert's mean, by the critic and in the simulator."""
    preferences = {}
    for source in dict.fromkeys(sources[1:]):
        columns = [k for k, name in enumerate(sources) if name == source]
        preferences[source] = {
            "critic": float((q[:, :1] > q[:, columns]).mean()),
            "simulator": float((returns[:, :1] > returns[:, columns]).mean()),
        }
    return preferences


@torch.no_grad()
def _values(critic: Critic, state: np.ndarray, action: np.ndarray) -> np.ndarray:
    """states (N, S), actions (N, A) -> Q (M, N) in reward units."""
    device = critic.spread.device
    return critic(torch.from_numpy(state).to(device), torch.from_numpy(action).to(device)).cpu().numpy()


def _write(table: Path, sources: list[str], q: np.ndarray, returns: np.ndarray) -> None:
    """Writes one row per state and candidate. q, returns: (V, K) in reward units."""
    with open(table, "w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["state", "source", "q", "return"])
        for v in range(len(q)):
            writer.writerows([v, source, f"{q[v, k]:.6g}", f"{returns[v, k]:.6g}"] for k, source in enumerate(sources))
