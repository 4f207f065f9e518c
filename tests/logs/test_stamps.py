"""Stamps: which are the same instant, and how much time they say has passed."""

import numpy as np
import pytest

from sixthsense.logs.log import Odometry, ascending, matched, passed_s
from sixthsense.logs.text_lines import unit_of


def test_a_stamp_matches_the_nearest_one_within_half_a_period():
    rng = np.random.default_rng(2)
    for _ in range(20):
        stamps = 1.7e9 + np.cumsum(rng.uniform(0.1, 0.4, 30))[rng.permutation(30)]
        wanted = 1.7e9 + rng.uniform(-1.0, 9.0, (40, 2))
        found, half = matched(stamps, wanted), 0.5 * np.median(np.diff(np.sort(stamps)))
        for row, at in zip(found.ravel(), wanted.ravel(), strict=True):
            off = np.abs(stamps - at)
            assert row == (np.argmin(off) if off.min() <= half else -1)
    assert matched([3.0, 1.0, 3.0], [3.2, 1.0, 4.5]).tolist() == [0, 1, -1]
    assert matched([5.0], [5.0, 5.1]).tolist() == [0, -1] and matched([], [1.0]).tolist() == [-1]


def test_stamps_ascend_are_spread_where_they_are_shared_and_are_of_the_unit_that_makes_them_recent():
    assert ascending([7, 9, 3, 4, 30]).tolist() == [7, 9, 10, 11, 30]
    for stamps_s, expected in (
        ([1.0, 1.3, 1.7], [0.3, 0.4]), ([1.0, 1.0, 1.6, 2.0], [0.3, 0.3, 0.4]),
        ([1.0, 2.0, 2.0, 2.0], [1.0, 1.0, 1.0]), ([7.0, 7.0, 7.0], [np.inf, np.inf]),
    ):  # fmt: skip
        assert passed_s(np.round(1e9 * np.array(stamps_s)).astype(np.int64)) == pytest.approx(expected)
    for stamp, name in ((1.7e9, "seconds"), (3.0, "seconds"), (1.7e12, "milliseconds"), (1.7e18, "nanoseconds")):
        assert unit_of(np.array([stamp, 1.01 * stamp]))[1] == name


def test_without_a_time_no_motion_is_a_jump_and_with_one_it_is():
    poses = np.array([[1.3 * k, 0.2, 0.1 * k] for k in range(9)])
    assert not len(Odometry(np.arange(70, 79), poses).jumps())
    assert len(Odometry(20_000_000 * np.arange(9), poses).jumps()) == 8
