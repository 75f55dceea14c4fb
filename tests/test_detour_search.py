"""The search for detours of pose tasks."""

import numpy as np
import pytest

from acgd.experts.muscle import detour_search
from acgd.experts.muscle.detours import CLENCHED, DETOURS, Detour
from acgd.experts.muscle.settings import ControllerSettings
from acgd.simulate.seeds import SEEDS
from acgd.tasks import registry
from acgd.tasks.settings import TaskConfig

TEACHER = ControllerSettings(rate=2.5, damping=0.3)


def test_the_shipped_detour_scores_better_than_the_straight_way():
    """Which ends beyond the threshold: its score counts the miss."""
    env = registry.make(TaskConfig(name="myo/pose"), image_size=None)
    seeds, known = SEEDS.expert_training.take(3), DETOURS["myo/pose"]
    straight = Detour(steps=0, gain=1.0, posture=np.zeros(len(CLENCHED)), share=np.ones(len(CLENCHED)))
    assert (
        detour_search.score(env, known, TEACHER, seeds) < 0.9 < 1.3 < detour_search.score(env, straight, TEACHER, seeds)
    )


def test_a_search_repeats_itself_and_moves():
    """From FIRST, by more than nothing and less than its spread."""
    one, two = (
        [next(generations) for _ in range(2)][-1]
        for generations in (detour_search.search("myo/pose", TEACHER, population=4, episodes=1) for _ in range(2))
    )
    assert np.array_equal(one.detour.posture, two.detour.posture) and (one.score, one.rate) == (two.score, two.rate)
    assert 0 < np.abs(one.detour.posture).max() < 3 * detour_search.SPREAD and one.number == 2


def test_vector_and_detour_are_inverse():
    detour, settings = detour_search._decode(detour_search._initial_vector(), TEACHER)
    assert (detour.steps, detour.gain, settings.rate) == pytest.approx((20, 3.0, 2.5))
    assert set(detour.posture) == {0.0} and set(detour.share) == {1.3}


def test_other_tasks_are_refused():
    with pytest.raises(ValueError, match="myo/reach.*pose tasks"):
        next(detour_search.search("myo/reach", TEACHER))
