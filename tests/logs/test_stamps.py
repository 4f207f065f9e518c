"""Stamps: which are the same instant, and how much time they say has passed."""

import numpy as np
import pytest

from sixthsense.config.errors import InputError
from sixthsense.core.geometry import Pose
from sixthsense.core.source import Tick
from sixthsense.logs.joining import Odometry
from sixthsense.logs.log import Log, Relations
from sixthsense.logs.replay_input import relations_of
from sixthsense.logs.stamps import ascending, matched, passed_s, unit_of


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


@pytest.mark.parametrize(("stamps_s", "expected"), [
    ([1.0, 1.3, 1.7], [0.3, 0.4]), ([1.0, 1.0, 1.6, 2.0], [0.3, 0.3, 0.4]), ([1.0, 2.0, 2.0, 2.0], [1.0, 1.0, 1.0]),
    ([7.0, 7.0, 7.0], [np.inf, np.inf]),
])  # fmt: skip
def test_records_that_share_a_stamp_are_spread_up_to_the_next_one(stamps_s, expected):
    assert passed_s(np.round(1e9 * np.array(stamps_s)).astype(np.int64)) == pytest.approx(expected)


def test_stamps_ascend_and_are_of_the_unit_that_makes_them_recent():
    assert ascending([7, 9, 3, 4, 30]).tolist() == [7, 9, 10, 11, 30]
    for stamp, name in ((1.7e9, "seconds"), (3.0, "seconds"), (1.7e12, "milliseconds"), (1.7e18, "nanoseconds")):
        assert unit_of(np.array([stamp, 1.01 * stamp]))[1] == name


def test_without_a_time_no_motion_is_a_jump_and_with_one_it_is():
    poses = np.array([[1.3 * k, 0.2, 0.1 * k] for k in range(9)])
    assert not len(Odometry(np.arange(70, 79), poses).jumps())
    assert len(Odometry(20_000_000 * np.arange(9), poses).jumps()) == 8


def test_relations_with_rounded_stamps_are_of_the_nearest_scans_and_how_many_is_said():
    stamps = 1.2e9 + 0.21 * np.arange(50) + 4.4e-6
    log = Log([Tick(round(1e9 * at), Pose(0.1 * k), log_stamp_s=at) for k, at in enumerate(stamps)])
    given = np.column_stack([stamps[:40].round(5), stamps[7:47].round(5)])
    given[3, 1] += 20.0
    notes: list[str] = []
    found = relations_of(log, Relations(given, np.arange(120.0).reshape(40, 3)), "some.relations", notes)
    kept = np.delete(np.arange(40), 3)
    assert np.array_equal(found.stamps, np.column_stack([stamps[kept], stamps[kept + 7]]))
    assert found.poses[3].tolist() == [12.0, 13.0, 14.0]
    assert notes[0].startswith("39 of 40 relations are of scans, 4.")
    assert notes[0].endswith("1 name stamps of no scan and are left out")
    with pytest.raises(InputError, match="found no relation between scans of the log"):
        relations_of(log, Relations(given + 1e3, np.zeros((40, 3))), "x", [])
