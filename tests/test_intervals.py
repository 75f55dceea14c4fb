"""Intervals: known values, a level that holds without a true difference, and a width that is never zero."""

import numpy as np
import pytest
from scipy.stats import binomtest

from acgd.evaluation.intervals import episode_noise, half_width, mcnemar, over_seeds, paired_difference
from acgd.simulate.proportion import wilson
from benchmarks import verdict


@pytest.mark.parametrize("n", [1, 5, 25, 200])
def test_wilson_agrees_with_its_formula(n):
    for k in range(0, n + 1, max(1, n // 7)):
        z, proportion = 1.959964, wilson(k, n)
        for bound in (proportion.low, proportion.high):  # the rates whose score statistic is z
            assert abs(k / n - bound) == pytest.approx(z * np.sqrt(bound * (1 - bound) / n), abs=1e-6)
        assert proportion.rate == k / n and 0 <= proportion.low < proportion.high <= 1


def test_wilson_refuses_what_is_no_rate():
    for k, n in ((0, 0), (3, 2), (-1, 4)):
        with pytest.raises(ValueError, match="successes"):
            wilson(k, n)


def test_over_seeds_is_the_t_interval_and_one_seed_tells_nothing_of_the_next():
    interval = over_seeds([0.5, 0.52, 0.54])
    assert (interval.mean, interval.high - interval.mean) == pytest.approx((0.52, 4.302653 * 0.02 / 3**0.5), abs=1e-6)
    assert (over_seeds([0.4]).low, over_seeds([0.4]).high) == (0.0, 1.0)


def test_seeds_that_agree_have_the_width_of_their_episodes():
    least = episode_noise([75, 70], [75, 75])
    interval = over_seeds([0.96, 0.96, 0.96], least)
    assert interval.high - interval.mean == pytest.approx(min(0.04, least)) and interval.low < 0.96
    assert episode_noise([75], [75]) > 0


def test_mcnemar_is_the_sign_test():
    assert mcnemar(10, 2) == pytest.approx(2 * (1 + 12 + 66) / 2**12) == binomtest(10, 12).pvalue
    assert mcnemar(3, 3) == mcnemar(0, 0) == 1.0


def test_paired_difference_counts_and_bounds():
    a = np.array([[1, 1, 0, 1], [1, 0, 0, 1]], bool)
    b = np.array([[1, 0, 0, 0], [1, 0, 1, 0]], bool)
    difference = paired_difference([a], [b])
    assert (difference.wins, difference.losses, difference.episodes) == (3, 1, 8)
    assert difference.mean == pytest.approx(0.25) and difference.low < 0.25 < difference.high
    swapped = paired_difference([b], [a])
    assert (swapped.mean, swapped.low, swapped.high) == pytest.approx(
        (-difference.mean, -difference.high, -difference.low), abs=1e-12
    )


def test_seeds_far_apart_take_students_t():
    a = np.zeros((3, 40), bool)
    a[0], a[1, :20] = True, True
    difference = paired_difference([a], [np.zeros((3, 40), bool)])
    by_start = a.mean(axis=0)  # two thirds on the first half, one third on the other
    noise = ((a - a.mean(axis=1, keepdims=True) - by_start + a.mean()) ** 2).sum() / (2 * 39)
    of_starts = by_start.var(ddof=1) / 40 - noise / 120
    half = np.sqrt(4.302653**2 * 0.25 / 3 + 2.022691**2 * max(0, of_starts))
    assert difference.low == pytest.approx(0.5 - half, abs=1e-6) and difference.high == 1.0


@pytest.mark.parametrize("students", [1, 3, 5])
@pytest.mark.parametrize("value", [-1, 0, 1])
def test_no_interval_is_without_width(students: int, value: int):
    for episodes in (1, 25):
        same = np.full((students, episodes), value)
        assert half_width([same]) > 0.01 and half_width([same, same]) > 0.01
    ones = np.ones((students, 25), bool)
    difference = paired_difference([ones], [~ones])
    assert difference.low < difference.mean == difference.high == 1


def test_paired_difference_gains_from_pairing_and_pays_for_student_seeds():
    rng = np.random.default_rng(0)
    start = rng.random((1, 40)) < 0.5  # what is hard depends on the start, the same for both variants
    a, b = np.repeat(start, 4, axis=0), np.repeat(start, 4, axis=0)
    b[:, np.flatnonzero(start[0])[:4]] = False
    paired, unpaired = paired_difference([a], [b]), paired_difference([a], [np.roll(b, 7, axis=1)])
    assert paired.high - paired.low < 0.6 * (unpaired.high - unpaired.low)
    between = np.zeros((4, 40), bool)
    between[0] = True  # the same share of wins as below, but all of them are one student's
    within = np.tile(np.arange(40) % 4 == 0, (4, 1))
    none = np.zeros((4, 40), bool)
    wide, narrow = paired_difference([between], [none]), paired_difference([within], [none])
    assert wide.mean == narrow.mean and wide.high - wide.low > 1.5 * (narrow.high - narrow.low)


def test_paired_difference_covers_the_truth():
    """Students differ in skill by 10 points, starts in difficulty; the true difference is 0.1."""
    rng, hits = np.random.default_rng(1), 0
    for _ in range(400):
        easy, skill = rng.uniform(0.3, 0.6, (1, 25)), rng.normal(0, 0.1, (8, 1))
        a, b = (rng.random((8, 25)) < easy + gain + skill for gain in (0.1, 0.0))
        difference = paired_difference([a], [b])
        hits += difference.low <= 0.1 <= difference.high
    assert hits >= 372


def test_paired_difference_refuses_what_does_not_pair():
    with pytest.raises(ValueError, match="student seeds, episodes"):
        paired_difference([np.zeros((2, 5), bool)], [np.zeros((2, 4), bool)])


def test_without_a_true_difference_the_interval_excludes_zero_in_at_most_six_of_a_hundred_studies():
    rates = {cell: verdict.rate(cell, verdict.report) for cell in verdict.CELLS}
    assert {cell: rate for cell, rate in rates.items() if rate > verdict.LEVEL} == {}


@pytest.mark.parametrize("students", [3, 5, 10])
def test_the_level_holds_where_starts_decide_for_each_variant_in_its_own_way(students: int):
    for by_start in (0.5, 1.0):
        cell = verdict.Cell(students, 0.05, 0.9, 25, 1, by_start)
        assert verdict.rate(cell, verdict.report, 2000) <= verdict.LEVEL


def test_the_simulation_notices_an_interval_that_does_not_hold_its_level():
    few = verdict.Cell(students=3, spread=0.14, base=0.5, episodes=100, tasks=1)
    assert verdict.rate(few, verdict.bootstrap, 500) > 2 * verdict.LEVEL
    assert verdict.rate(few._replace(gain=0.9), verdict.report, 500) > 0.9
