"""What each damage of a log changes, and what it leaves alone."""

import importlib
import itertools
import math
from pathlib import Path

import numpy as np
import pytest

from sixthsense.config import LaserConfig
from sixthsense.core.geometry import Pose
from sixthsense.core.laser import Scan, beam_bearings
from sixthsense.core.ray_casting import cast_rays
from sixthsense.core.source import Tick
from sixthsense.sources.logs.log import Log
from sixthsense.sources.logs.relations import Relations

BENCHMARKS = Path(__file__).resolve().parents[2] / "benchmarks"
CORNERS = np.array([[-1.0, -2.0], [9.0, -2.0], [9.0, 3.0], [-1.0, 3.0]])
WALLS = np.stack([CORNERS, np.roll(CORNERS, -1, axis=0)], axis=1)
LASER = LaserConfig(beams=90, fov=math.radians(178.0), max_range=9.0, mount=(0.1, 0.05, 0.02))
FORWARD, TURNING = 60, 40
"""ticks of each straight, and of the half turn after it"""


def is_turning(k: int) -> bool:
    return k % (FORWARD + TURNING) >= FORWARD


@pytest.fixture(scope="module")
def log() -> Log:
    """A robot drives to and fro in a room; ticks without a scan lie between the scans."""
    pose, ticks = Pose(), []
    for k in range(600):
        seen = pose @ Pose(*LASER.mount)
        scan = Scan.from_config(cast_rays(seen, beam_bearings(LASER), WALLS, LASER.max_range), LASER)
        ticks.append(Tick(200_000_000 * k, pose, scan, log_stamp_s=1000.0 + 0.2 * k))
        pose = pose @ (Pose(theta=math.pi / TURNING) if is_turning(k) else Pose(x=0.1))
    return Log(ticks, LASER)


@pytest.fixture(scope="module")
def relations(log) -> Relations:
    pairs = np.array([(0, 70), (65, 165), (100, 300), (450, 599)])
    poses = [log.ticks[a].odometry.inverse() @ log.ticks[b].odometry for a, b in pairs]
    return Relations(1000.0 + 0.2 * pairs, np.array([pose.array() for pose in poses]))


@pytest.fixture
def script(monkeypatch):
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    return importlib.import_module("damaged_logs")


def ranges(log: Log) -> np.ndarray:
    return np.array([scan.ranges for scan in log.scans])


def odometry(log: Log) -> np.ndarray:
    return np.array([tick.odometry.array() for tick in log.ticks])


def steps(log: Log) -> np.ndarray:
    return np.array([(a.odometry.inverse() @ b.odometry).array() for a, b in itertools.pairwise(log.ticks)])


def assert_same(made, log, relations) -> None:
    np.testing.assert_array_equal(ranges(made.log), ranges(log))
    np.testing.assert_allclose(odometry(made.log), odometry(log), atol=1e-12)
    np.testing.assert_allclose([s.bearings for s in made.log.scans], [s.bearings for s in log.scans], atol=1e-6)
    assert [t.stamp_ns for t in made.log.ticks] == [t.stamp_ns for t in log.ticks]
    np.testing.assert_allclose(made.relations.stamps, relations.stamps, atol=1e-6)
    np.testing.assert_allclose(made.relations.poses, relations.poses)
    assert made.log.laser == log.laser


def test_no_damage_changes_nothing_but_ticks_without_a_scan(script, log, relations):
    between = Tick(log.ticks[3].stamp_ns + 1, Pose())
    longer = Log([*log.ticks[:4], between, *log.ticks[4:]], LASER)
    assert_same(script.damaged("clean", longer, relations, 0), log, relations)


@pytest.mark.parametrize("name", ["mirrored", "backwards"])
def test_a_log_mirrored_or_reversed_twice_is_the_log(script, log, relations, name):
    once = script.damaged(name, log, relations, 0)
    assert_same(script.damaged(name, *once, 0), log, relations)


@pytest.mark.parametrize("name", ["clean", "mirrored", "backwards", "gaps", "blanks", "people", "rough"])
def test_relations_stay_true_where_the_odometry_is(script, log, relations, name):
    made = script.damaged(name, log, relations, 0)
    at = {round(tick.log_stamp_s, 4): tick.odometry for tick in made.log.ticks}
    for (before, after), pose in zip(made.relations.stamps, made.relations.poses, strict=True):
        motion = at[round(before, 4)].inverse() @ at[round(after, 4)]
        np.testing.assert_allclose(motion.array(), pose, atol=1e-9)


@pytest.mark.parametrize("name", ["mirrored", "backwards"])
def test_the_room_is_where_it_was_up_to_the_mirror(script, log, relations, name):
    made = script.damaged(name, log, relations, 0).log
    side = -1.0 if name == "mirrored" else 1.0
    for tick in made.ticks[::50]:
        points = tick.odometry @ tick.scan.points_robot[np.isfinite(tick.scan.ranges)]
        x, y = points[:, 0], side * points[:, 1]
        gap = np.min(np.abs([x + 1.0, x - 9.0, y + 2.0, y - 3.0]), axis=0)
        assert gap.max() < 1e-5


def test_gaps_begin_where_the_robot_turns_and_last_two_to_four_seconds(script, log, relations):
    made = script.damaged("gaps", log, relations, 0)
    kept = {tick.stamp_ns for tick in made.log.ticks}
    gone = [k for k, tick in enumerate(log.ticks) if tick.stamp_ns not in kept]
    begins = [k for k in gone if k - 1 not in gone]
    assert begins and all(is_turning(k) or is_turning(k - 4) or is_turning(k + 4) for k in begins)
    lengths = [sum(begin <= k < begin + 100 for k in gone) for begin in begins]
    assert all(10 <= length <= 21 for length in lengths)
    assert set(np.round(made.relations.stamps, 4).ravel()).isdisjoint(np.round([1000.0 + 0.2 * k for k in gone], 4))


def test_people_only_shorten_ranges(script, log, relations):
    made, before = ranges(script.damaged("people", log, relations, 0).log), ranges(log)
    assert (made <= before).all()
    assert 0.005 < (made < before).mean() < 0.3


def test_blanks_are_scans_without_any_return_and_the_others_stay(script, log, relations):
    made, before = ranges(script.damaged("blanks", log, relations, 0).log), ranges(log)
    changed = (made != before).any(axis=1)
    assert 20 <= changed.sum() <= 60
    assert np.isinf(made[changed]).all()


def test_a_rough_laser_loses_a_tenth_of_its_returns_and_is_off_by_three_centimetres(script, log, relations):
    made, before = ranges(script.damaged("rough", log, relations, 0).log), ranges(log)
    known = np.isfinite(before) & (before < 8.5)
    assert np.isinf(made[known]).mean() == pytest.approx(0.1, abs=0.01)
    both = known & np.isfinite(made)
    assert (made[both] - before[both]).std() == pytest.approx(0.03, rel=0.05)


def test_wheels_bump_spin_and_mislead_where_the_scans_stay(script, log, relations):
    before = steps(log)
    for name in ("bumps", "spins", "wheels"):
        made = script.damaged(name, log, relations, 0).log
        np.testing.assert_array_equal(ranges(made), ranges(log))
        off = steps(made) - before
        moved, turned = np.abs(off[:, :2]).max(axis=1), np.abs(off[:, 2])
        if name == "bumps":
            assert (turned > 1e-6).sum() == 6 and turned[turned > 1e-6].min() > 0.2 and turned.max() < 0.5
            assert moved.max() < 1e-9
        if name == "spins":
            assert (moved > 1e-6).sum() == 30 and 1.8 < moved.sum() < 4.8 and turned.max() < 1e-9
        if name == "wheels":
            straight = np.array([not is_turning(k) for k in range(len(before))])
            np.testing.assert_allclose(moved[straight], 0.05 * before[straight, 0])
            np.testing.assert_allclose(turned[straight], 0.04 * before[straight, 0])


def test_a_seed_gives_one_damage(script, log, relations):
    made = [ranges(script.damaged("people", log, relations, seed).log) for seed in (1, 1, 2)]
    np.testing.assert_array_equal(made[0], made[1])
    assert (made[0] != made[2]).any()
