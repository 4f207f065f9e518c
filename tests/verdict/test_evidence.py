"""What scans say of each other, and what explains a disagreement of wheels and trajectory, on inputs drawn by hand."""

import math

import numpy as np
import pytest
from driven import config, ticks

from sixthsense.core.geometry import Pose
from sixthsense.core.laser import Scan
from sixthsense.core.se2 import between, compose
from sixthsense.verdict.disagreement import disagreement, lag, mount, turns
from sixthsense.verdict.evidence import _cuts, _overlaps, evidence_of, over_window, share, sum_over_window
from sixthsense.verdict.judge import judge
from sixthsense.verdict.probability import FEATURES, map_features
from sixthsense.verdict.views import (
    ALL,
    FEWEST,
    SURFACE,
    THROUGH,
    beyond_m,
    compared,
    old_pairs,
    recent_pairs,
    travelled,
    views_of,
)
from sixthsense.verdict.witnesses import Witnesses

MOUNT = Pose(0.13, -0.07, 0.3)
RNG = np.random.default_rng(5)


def wall(distance_m, beams=61, fov=1.4, max_range=8.0):
    """A scan of a wall across the laser's x axis."""
    bearings = np.linspace(-0.5 * fov, 0.5 * fov, beams)
    ranges = (distance_m / np.cos(bearings)).astype(np.float32)
    ranges[ranges >= max_range] = np.inf
    return Scan(ranges, np.float32(-0.5 * fov), np.float32(fov / (beams - 1)), max_range, MOUNT)


@pytest.mark.parametrize(("x", "y", "beyond"), [
    (3.1, 0.4, 0.0), (2.2, 0.3, 0.9), (2.2, -1.3, 0.9), (3.9, 0.4, -1.0), (-3.1, 0.4, -1.0), (0.4, 2.9, -1.0),
    (3.0, 0.2, 0.0), (2.88, 0.2, -1.0),
])  # fmt: skip
def test_a_place_is_a_surface_seen_through_or_not_to_be_told(x, y, beyond):
    """A place before the wall is seen through by the way along its beam; one behind, outside or too near is not."""
    found = beyond_m(views_of([wall(3.1)]), 0, x, y)
    expected = beyond if beyond <= 0.0 else math.hypot(x, y) * 3.1 / x - math.hypot(x, y)
    assert found == pytest.approx(expected, abs=0.08 if beyond > 0.0 else 1e-12)


def test_a_beam_without_a_return_tells_nothing():
    assert beyond_m(views_of([wall(9.5)]), 0, 4.0, 0.2) == -1.0


@pytest.mark.parametrize(("off_m", "column"), [(0.02, SURFACE), (1.2, THROUGH)])
def test_a_wall_that_is_seen_from_two_poses_is_confirmed_or_seen_through(off_m, column):
    """The second scan is taken 0.7 m nearer to the wall; its pose is off along the wall's normal."""
    views = views_of([wall(3.1), wall(2.4)])
    first = Pose(1.2, -0.8, 0.9)
    second = first @ MOUNT @ Pose(0.7 - off_m, 0.0) @ MOUNT.inverse()
    found = compared(views, np.array([first.array(), second.array()]), np.array([[0, 1]]))[0]
    assert found[ALL] == 120 and found[column] > 45
    assert (found[THROUGH] > 0) == (column != SURFACE)


def test_a_closed_fan_has_a_beam_behind_its_last():
    ranges = np.full(90, 4.0, np.float32)
    views = views_of([Scan(ranges, np.float32(-math.pi), np.float32(math.tau / 90), 9.0)])
    assert beyond_m(views, 0, -2.5, -0.01) == pytest.approx(1.5, abs=1e-3) and beyond_m(views, 0, -4.0, 0.01) == 0.0


def test_keyframes_are_compared_with_those_of_the_last_metres_and_of_other_passes():
    """A way of 30 m to and fro: the pairs by plain search."""
    x = np.concatenate([np.arange(0.0, 15.0, 0.5), np.arange(14.9, 0.0, -0.5)])
    trajectory = np.stack([x, np.full_like(x, 0.7), np.where(np.arange(len(x)) < 30, 0.0, math.pi - 0.1)], axis=1)
    travel = travelled(trajectory)
    assert travel[29] == pytest.approx(14.5) and travel[-1] > 29.0
    recent = recent_pairs(travel)
    back = travel[recent[:, 1]] - travel[recent[:, 0]]
    assert np.all(back > 0.0) and back.max() <= 12.0 and set(range(1, 30)) <= set(recent[:, 1].tolist())
    old = old_pairs(trajectory, travel)
    assert len(old) and np.all(travel[old[:, 1]] - travel[old[:, 0]] > 10.0)
    assert np.all(np.abs(x[old[:, 0]] - x[old[:, 1]]) <= 4.0)
    assert {0, 5, 10} <= set(old[:, 0].tolist())


def test_a_run_counts_its_keyframes_near_another_pass_by_which_a_missed_loop_closure_is_seen():
    """A way of 15 m along a wall, once, and to and fro."""

    def counted(x):
        poses = np.stack([x, np.full_like(x, 0.7), np.full_like(x, 0.3)], axis=1)
        seen = Witnesses(np.arange(len(x)), poses, None, np.arange(len(x)), poses, x > -1.0, [wall(3.1)] * len(x))
        return judge(seen).evidence["keyframes_passed_before"], np.unique(old_pairs(poses, travelled(poses)))

    once, again = np.arange(0.0, 15.0, 0.5), np.arange(14.9, 0.0, -0.5)
    assert counted(once)[0] == 0.0
    count, near = counted(np.concatenate([once, again]))
    assert count == len(near) > 20


def motions(count=60):
    """(count, 3) steps of a robot that drives and turns, and its trajectory."""
    steps = np.stack([RNG.uniform(0.1, 0.4, count), np.zeros(count), RNG.uniform(-0.5, 0.5, count)], axis=1)
    poses = [np.array([0.4, -1.2, 0.8])]
    for step in steps:
        poses.append(compose(poses[-1], step))
    return np.array(poses)


@pytest.mark.parametrize("off", [(0.31, -0.12, 0.0), (-0.2, 0.25, 0.15), (0.0, 0.0, 0.0), (0.12, 0.03, 3.0)])
def test_the_mount_is_found_from_motions_of_wheels_and_scans_with_the_scale_of_the_wheels(off):
    """The trajectory is of a robot whose laser is believed `off` beside its place; wheels count 4 % too little."""
    robot = motions()
    path = compose(robot, np.array([off]))
    steps = between(robot[:-1], robot[1:]) * (1.0 / 1.04, 1.0 / 1.04, 1.0)
    wheels = [robot[0]]
    for step in steps:
        wheels.append(compose(wheels[-1], step))
    found = mount(disagreement(np.array(wheels), path, np.ones(len(path), dtype=np.bool_)))
    assert found is not None
    assert found.offset[:2] == pytest.approx(off[:2], abs=0.02 + 0.1 * min(off[2], np.pi - off[2]))
    assert found.offset[2] == pytest.approx(off[2], abs=0.02) and found.scale == pytest.approx(1.04, abs=0.02)


def test_turns_that_are_against_the_wheels_have_a_slope_of_minus_one():
    robot = motions()
    mirrored = np.array(robot) * (1.0, -1.0, -1.0)
    known = np.ones(len(robot), dtype=np.bool_)
    assert turns(disagreement(robot, mirrored, known)).slope == pytest.approx(-1.0)
    assert turns(disagreement(robot, robot, known)).slope == pytest.approx(1.0)
    assert turns(disagreement(robot, robot, ~known)) is None


@pytest.mark.parametrize("late_s", [-1.2, 0.6, 2.1])
def test_a_delay_between_scans_and_wheels_is_found_with_its_sign(late_s):
    times = np.arange(0.0, 90.0, 0.1)
    heading = np.cumsum(0.08 * np.sin(0.7 * times) * (np.sin(0.13 * times) > 0.0))
    poses = np.stack([times, times, heading], axis=1)
    wheels = poses.copy()
    wheels[:, 2] = np.interp(times + late_s, times, heading)
    found = lag(times, wheels, poses)
    assert found.seconds == pytest.approx(late_s, abs=0.11) and found.gain > 0.8
    assert lag(times, poses, poses).seconds == 0.0


def test_shares_and_windows_are_those_of_plain_sums():
    found = np.array([[30.0, 10.0, 90.0], [4.0, 1.0, 20.0], [0.0, 0.0, 20.0]])
    assert FEWEST == 15 and share(found)[:2].tolist() == [10.0 / 55.0, 1.0 / 20.0] and math.isnan(share(found)[2])
    travel, values = np.array([0.0, 4.0, 9.0, 13.0, 30.0]), np.array([2.0, 7.0, math.nan, 3.0, 1.0])
    assert over_window(values, travel).tolist() == [2.0, 7.0, 7.0, 7.0, 1.0]
    assert sum_over_window(values, travel).tolist() == [2.0, 9.0, 9.0, 10.0, 1.0]


def test_one_scan_that_fits_nothing_is_no_cut_and_a_place_that_no_pair_spans_is_one():
    pairs = np.array([(k, k + step) for k in range(12) for step in (1, 2, 3) if k + step < 12])
    for cut_at, lone in ((6, 3), (None, 3), (6, None)):
        apart = np.zeros(len(pairs), dtype=bool)
        if cut_at is not None:
            apart |= (pairs[:, 0] < cut_at) & (pairs[:, 1] >= cut_at)
        if lone is not None:
            apart |= (pairs == lone).any(axis=1)
        judged = np.where(apart[:, None], [3, 57, 0, 90], [60, 0, 0, 90])
        judged[(pairs == (5, 8)).all(axis=1)] = 1, 0, 0, 90  # a pair that hardly sees the same says nothing
        cuts = _cuts(pairs, judged, 12)
        assert math.isnan(cuts[0]) and np.flatnonzero(cuts[1:] > 0.5).tolist() == (
            [] if cut_at is None else [cut_at - 1]
        )


def test_keyframes_without_a_return_untie_nothing_where_the_next_confirm_those_before():
    pairs = np.array([(k, k + step) for k in range(12) for step in (1, 2, 3) if k + step < 12])
    blank, apart = np.isin(pairs, (5, 6)).any(axis=1), (pairs[:, 0] < 6) & (pairs[:, 1] >= 6)
    for none, untied in ((blank, []), (apart, [6])):
        overlaps = _overlaps(pairs, np.where(none[:, None], 0, [60, 0, 90]), 12)
        assert math.isnan(overlaps[0]) and np.flatnonzero(overlaps[1:] < 0.6).tolist() == [k - 1 for k in untied]


def test_what_scans_contradict_on_either_side_alone_is_no_cut():
    """Where a laser meets the ground of a slope each scan contradicts the next; the robot may be carried there, too."""
    pairs = np.array([(k, k + step) for k in range(16) for step in (1, 2, 3) if k + step < 16])
    on_slope = np.tile([45, 45, 0, 90], (len(pairs), 1))
    assert _cuts(pairs, on_slope, 16)[1:].max() == 0.0
    apart = (pairs[:, 0] < 8) & (pairs[:, 1] >= 8)
    cuts = _cuts(pairs, np.where(apart[:, None], [6, 84, 0, 90], on_slope), 16)
    assert cuts[8] == pytest.approx((84 - 45) / 105) and np.delete(cuts, [0, 8]).max() < 0.01


def test_a_scan_seen_in_a_mirror_is_itself_when_it_is_seen_in_one_again():
    scan = ticks()[4].scan
    assert scan is not None and config().laser.mirrored is False
    once = scan.mirrored()
    points, seen = scan.points_robot, once.points_robot
    laser = scan.T_robot_laser.inverse()
    returned = np.isfinite(scan.ranges)
    assert (laser @ seen[::-1][returned]) == pytest.approx((laser @ points[returned]) * (1.0, -1.0), abs=2e-5)
    assert np.array_equal(once.mirrored().ranges, scan.ranges)


@pytest.mark.parametrize("count", [0, 1, 2, 3])
@pytest.mark.parametrize("has_wheels", [True, False])
def test_a_run_of_a_few_keyframes_is_not_judged(count, has_wheels):
    own = ticks()[: 9 * count : 9]
    poses = np.array([tick.odometry.array() for tick in own]).reshape(-1, 3)
    stamps = np.array([tick.stamp_ns for tick in own], dtype=np.int64)
    wheels, measured = poses if has_wheels else None, np.ones(count, dtype=np.bool_)
    for scans in (tuple(tick.scan for tick in own), ()):
        verdict = judge(Witnesses(stamps, poses, wheels, np.arange(count), poses, measured, scans))
        assert verdict.level == "unjudged" and len(verdict.keyframes) == count
        assert verdict.probability is None and verdict.reason in str(verdict)


@pytest.mark.parametrize(("beams", "step_m", "reason"), [(5, 0.3, "returns"), (61, 0.02, "hardly moved")])
def test_a_robot_that_stands_or_sees_little_is_not_judged_and_one_that_drives_and_sees_is_good(
    beams, step_m, reason, monkeypatch
):
    def verdict(beams, step_m):
        poses = np.array([[step_m * k, 0.1, 0.02] for k in range(12)])
        scans = [wall(6.0 - step_m * k, beams) for k in range(12)]
        stamps, measured = np.arange(12) * 500_000_000, np.ones(12, dtype=np.bool_)
        return judge(Witnesses(stamps, poses, poses, np.arange(12), poses, measured, scans))

    found = verdict(beams, step_m)
    assert found.level == "unjudged" and reason in found.reason
    assert verdict(61, 0.3).level == "good"
    monkeypatch.setattr("sixthsense.verdict.judge.DOUBTFUL_FROM", 0.0)
    assert verdict(beams, step_m).level == ("unjudged" if beams == 5 else "doubtful")


@pytest.mark.parametrize(
    ("recent", "old", "expected"), [(3.0, 3.0, 0.0), (0.0, 3.0, 0.3), (1.0, 2.0, 0.1), (3.0, 0.0, 0.0)]
)
def test_other_passes_are_evidence_beyond_what_one_pass_contradicts_of_itself(recent, old, expected):
    """Of 12 keyframes, with 10 returns each that are judged, so many are seen through."""
    poses = np.array([[0.3 * k, 0.1, 0.02] for k in range(12)])
    own = evidence_of(Witnesses(np.arange(12) * 500_000_000, poses, None, np.arange(12), poses, poses[:, 0] > 0.0, ()))
    judged = {
        name: np.tile([10.0 - through, through, 20.0], (12, 1)) for name, through in (("recent", recent), ("old", old))
    }
    found = map_features(own._replace(**judged), np.zeros((12, len(FEATURES))))
    assert found[FEATURES.index("old")] ** 2 == pytest.approx(expected * 120.0 / (120.0 + FEWEST), abs=1e-9)
    assert np.count_nonzero(found) == (expected > 0.0)
    bent = map_features(own._replace(bends=0.09), np.full((12, len(FEATURES)), 0.2))
    assert bent[FEATURES.index("recent")] == pytest.approx(0.3)


def test_a_front_end_that_the_verdict_is_not_fitted_to_is_named():
    poses, scans = np.array([[0.3 * k, 0.1, 0.02] for k in range(12)]), [wall(6.0 - 0.3 * k) for k in range(12)]
    stamps, measured = np.arange(12) * 500_000_000, np.ones(12, dtype=np.bool_)
    seen = Witnesses(stamps, poses, poses, np.arange(12), poses, measured, scans, own_front_end="lab.matcher:Matcher")
    assert judge(seen).level == "unjudged" and "lab.matcher:Matcher" in str(judge(seen))
