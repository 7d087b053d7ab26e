import math

import numpy as np
import pytest
from scipy import stats

from prt.errors import PrtError
from prt.metrics.intervals import better, mean_interval


def test_few_values_give_students_interval():
    values = [30.0, 31.0, 29.5, 32.0]
    want = stats.t.interval(0.95, 3, np.mean(values), stats.sem(values))
    assert mean_interval(values) == pytest.approx((np.mean(values), *want, 4))


def test_many_values_give_a_bootstrap_close_to_the_normal_interval():
    values = np.random.default_rng(0).normal(5, 2, 400)
    mean, lo, hi, n = mean_interval(values)
    half = 1.96 * 2 / math.sqrt(400)
    assert n == 400 and mean == pytest.approx(values.mean())
    assert [mean - lo, hi - mean] == pytest.approx([half, half], rel=0.15)


def test_deterministic_in_the_seed():
    values = np.random.default_rng(0).random(50)
    assert mean_interval(values, seed=3) == mean_interval(values, seed=3)
    assert mean_interval(values, seed=3) != mean_interval(values, seed=4)


@pytest.mark.parametrize(("count", "size"), [(5, 1), (5, 4), (40, 3)])
def test_interval_over_groups_covers_as_often_as_it_says(count, size):
    """Values of a group share most of their error."""
    rng, trials = np.random.default_rng(count), 300
    groups, hits = np.repeat(np.arange(count), size).tolist(), 0
    for trial in range(trials):
        x = rng.normal(size=count).repeat(size) + 0.5 * rng.normal(size=count * size)
        interval = mean_interval(x, seed=trial, groups=groups)
        hits += interval.lo < 0 < interval.hi
    assert 0.91 <= hits / trials <= 0.99


@pytest.mark.parametrize("count", [8, 30])
def test_copies_of_a_value_add_nothing(count):
    values = np.random.default_rng(2).random(count)
    once = mean_interval(values)
    copies = mean_interval(values.repeat(5), groups=np.arange(count).repeat(5).tolist())
    assert copies[:3] == pytest.approx(once[:3])
    naive = mean_interval(values.repeat(5))
    assert naive.hi - naive.lo < 0.6 * (once.hi - once.lo)


def test_what_has_no_interval():
    assert np.isnan(mean_interval([])[:3]).all() and mean_interval([]).n == 0
    for interval in (mean_interval([4.0]), mean_interval([3.0, 5.0], groups=["a", "a"])):
        assert interval.mean == 4.0 and np.isnan([interval.lo, interval.hi]).all()
    broken = mean_interval([1.0, float("nan"), 2.0])
    assert np.isnan(broken[:3]).all() and broken.n == 3


def test_wrong_arguments_are_errors():
    with pytest.raises(PrtError, match="confidence=95"):
        mean_interval([1.0, 2.0], confidence=95)
    with pytest.raises(PrtError, match="1 labels for 2 values"):
        mean_interval([1.0, 2.0], groups=["a"])


def compare(a, b, direction, groups=None):
    """The verdict on a being better than b, pair by pair."""
    return better(mean_interval(np.asarray(a) - np.asarray(b), groups=groups), direction)


def test_pairing_finds_a_small_gain_under_a_large_common_spread():
    rng = np.random.default_rng(1)
    b = rng.normal(30, 5, 12)
    a = b + 0.5 + 0.1 * rng.normal(size=12)
    assert compare(a, b, "higher") == "holds"
    assert compare(b, a, "higher") == "fails"
    assert compare(a, b, "lower") == "fails"
    assert compare(b, a, "lower") == "holds"
    separate = mean_interval(a).lo, mean_interval(b).hi
    assert separate[0] < separate[1]  # unpaired, the intervals overlap


def test_what_is_undecided():
    rng = np.random.default_rng(1)
    a = rng.normal(size=12)
    assert compare(a, a + 0.01 * rng.normal(size=12), "higher") == "undecided"
    assert compare(a, a, "higher") == "undecided"
    assert compare([9.0], [1.0], "higher") == "undecided"
    assert compare([9.0, 9.1, float("nan")], [1.0, 1.1, 1.2], "higher") == "undecided"
    assert compare([], [], "higher") == "undecided"


def test_a_margin_is_in_the_metrics_own_unit():
    interval = mean_interval([1.0, 1.1, 0.9, 1.0])
    assert better(interval, "higher", 0.5) == "holds" and better(interval, "higher", 1.5) == "fails"
    assert better(mean_interval([-1.0, -1.1, -0.9, -1.0]), "lower", 0.5) == "holds"
    assert better(interval, "higher", 1.0) == "undecided"


def test_lightings_of_two_views_do_not_decide_a_claim_about_views():
    # one view gains 2 dB under every lighting, the other 0.1 dB: forty pairs, but two views
    gains = np.r_[np.full(20, 2.0), np.full(20, 0.1)] + 0.05 * np.random.default_rng(0).normal(size=40)
    b = np.full(40, 30.0)
    assert compare(b + gains, b, "higher") == "holds"
    assert compare(b + gains, b, "higher", groups=["p"] * 20 + ["q"] * 20) == "undecided"
