import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sixthsense.config import Config, FollowConfig, RobotConfig
from sixthsense.core.geometry import Array, Pose
from sixthsense.core.motion import rk4
from sixthsense.core.source import Command
from sixthsense.navigation.driver import Drive, Driver, DriverLimits, advanced, followed

FOLLOW, ROBOT = FollowConfig(), RobotConfig()


places = st.tuples(st.floats(-5.0, 5.0), st.floats(-5.0, 5.0))


def drive(path: Array, pose: Pose, follow: FollowConfig = FOLLOW, robot: RobotConfig = ROBOT) -> tuple[Array, Array]:
    """(T, 3) poses before, and (T, 2) commands of, each tick of a drive without noise, until the robot stands still."""
    limits, rows = DriverLimits.of(Config(follow=follow, robot=robot)), []
    at, is_driving = 1, False
    while len(rows) < 20_000:
        speed, turn_rate, at, is_driving = followed(path, at, is_driving, (pose.x, pose.y, pose.theta), limits)
        rows.append((*pose.triple(), speed, turn_rate))
        if speed == turn_rate == 0.0:
            assert at == len(path)
            return np.array(rows)[:, :3], np.array(rows)[:, 3:]
        pose = rk4(pose, speed, turn_rate, robot.control_period_s, 0.01)
    raise AssertionError("the robot never stood still")


OWN = DriverLimits(
    distance_slack_m=0.03, heading_slack_rad=0.04, speed=0.7, turn_rate=1.3, period_s=0.05, patience_ns=7e9
)
AT = (1.7, -2.4, 0.6)
WAY = np.array([[1.2, -2.9], [1.7 + 3.0 * math.cos(0.6), -2.4 + 3.0 * math.sin(0.6)], [5.3, 2.2]])


def followed_from(off_m: float = 3.0, off_rad: float = 0.0, is_driving: bool = False) -> tuple[float, float, int, bool]:
    """One tick at so many metres from the way point, and so far turned away from it."""
    back = 3.0 - off_m
    pose = (AT[0] + back * math.cos(AT[2]), AT[1] + back * math.sin(AT[2]), AT[2] - off_rad)
    return followed(WAY, 1, is_driving, pose, OWN)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_it_turns_on_the_spot_beyond_the_slack_of_heading_and_drives_within_it(side: float) -> None:
    """At most as fast as it can, and not beyond the direction of the way point in one tick."""
    assert followed_from(off_rad=side * 0.0399) == (0.7, pytest.approx(side * 2.0 * 0.0399 * 0.7 / 3.0), 1, True)
    assert followed_from(off_rad=side * 0.0401) == (0.0, pytest.approx(side * 0.0401 / 0.05), 1, False)
    assert followed_from(off_rad=side * 3.1) == (0.0, side * 1.3, 1, False)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_robot_that_drives_turns_on_the_spot_beyond_five_times_the_slack(side: float) -> None:
    assert followed_from(off_rad=side * 0.199, is_driving=True)[0] == 0.7
    assert followed_from(off_rad=side * 0.201, is_driving=True) == (0.0, side * 1.3, 1, False)
    near = followed_from(0.2, side * 0.19, is_driving=True)  # a way point that is near does not make it swing
    assert near == (0.7, pytest.approx(side * 2.0 * 0.19 * 0.7 / 0.25), 1, True)


def test_a_way_point_within_the_slack_of_distance_is_reached_and_none_is_overshot() -> None:
    assert followed_from(0.0301, is_driving=True) == (
        pytest.approx(0.0301 / 0.05),
        pytest.approx(0.0, abs=1e-9),
        1,
        True,
    )
    assert followed_from(0.0299, is_driving=True)[2:] == (2, False)
    for path in (WAY[:2], WAY[:1], WAY[:0]):
        assert followed(path, 1, True, (WAY[1, 0], WAY[1, 1], 0.6), OWN)[:2] == (0.0, 0.0)


DRIVE = Drive((4.1, 2.0), WAY, 1, True, False, 0.0, 0.0, (3 * 10**9, AT[0], AT[1]))
TURN = DRIVE._replace(path=WAY[:0], heading=3.13, left_rad=0.05)  # across the cut
THERE = TURN._replace(is_there=True)
STEERED, ARRIVED, NO_WAY, STUCK = range(4)


def at_goal(off_m: float) -> tuple[float, float, float]:
    return 4.1 + off_m * math.cos(2.2), 2.0 + off_m * math.sin(2.2), 0.6


@pytest.mark.parametrize(
    ("drive", "pose", "stamp_ns", "event"),
    [
        (DRIVE, at_goal(0.0501), 4 * 10**9, STEERED),
        (DRIVE, at_goal(0.0499), 4 * 10**9, ARRIVED),
        (DRIVE, AT, 10 * 10**9, STEERED),
        (DRIVE, AT, 10 * 10**9 + 1, STUCK),
        (DRIVE._replace(anchor=(-1, 0.0, 0.0)), AT, 10 * 10**9 + 1, STEERED),
        (DRIVE, (AT[0] + 0.0999 * 0.8, AT[1] - 0.0999 * 0.6, 0.6), 10 * 10**9 + 1, STUCK),
        (DRIVE, (AT[0] + 0.1001 * 0.8, AT[1] - 0.1001 * 0.6, 0.6), 10 * 10**9 + 1, STEERED),
        (TURN, (AT[0], AT[1], 3.1799 - math.tau), 4 * 10**9, STEERED),
        (TURN, (AT[0], AT[1], 3.1801 - math.tau), 4 * 10**9, NO_WAY),
        (TURN, (AT[0], AT[1], 3.0799), 4 * 10**9, NO_WAY),
        (THERE, (AT[0], AT[1], 3.1799 - math.tau), 4 * 10**9, STEERED),
        (THERE, (AT[0], AT[1], 3.1801 - math.tau), 4 * 10**9, ARRIVED),
    ],
    ids=[
        "before", "at goal", "patient", "stuck", "not watched", "no progress", "progress", "turns", "turned", "back",
        "looks", "looked",
    ],
)  # fmt: skip
def test_events_are_at_the_goal_without_progress_and_after_a_turn_alone(
    drive: Drive, pose: tuple[float, float, float], stamp_ns: int, event: int
) -> None:
    after, speed, turn_rate, found = advanced(drive, pose, stamp_ns, 0.0, OWN)
    assert found == event
    if len(after.path) and event == STEERED:
        assert (speed, turn_rate) == followed(WAY, 1, True, pose, OWN)[:2]
    elif not len(after.path):
        assert (speed, turn_rate) == (0.0, 1.3 if event == STEERED else 0.0)


def test_at_the_goal_the_robot_turns_as_far_as_was_asked_before_it_has_arrived() -> None:
    driver, pose = Driver(Config()), Pose(2.0, 1.0, 0.4)
    assert driver.step(pose, 0) == (Command(), None)
    driver.head_for(np.array([2.01, 1.0]), 3.0)
    driver.follow(np.array([[2.0, 1.0], [2.01, 1.0]]))
    turned, event, ticks = 0.0, None, 0
    while event is None:
        command, event = driver.step(Pose(2.0, 1.0, 0.4 + turned), ticks)
        turned, ticks = turned + 0.02 * command.turn_rate, ticks + 20_000_000
        assert command.speed == 0.0
    assert event == "arrived" and turned == pytest.approx(3.0, abs=0.03) and driver.is_there


def test_a_search_that_goes_on_is_not_begun_anew_and_a_path_ends_it() -> None:
    driver, pose = Driver(Config()), Pose(2.0, 1.0, 0.4)
    driver.head_for(np.array([5.0, 1.0]), 0.0)
    driver.search(pose, 2.0)
    driver.step(Pose(2.0, 1.0, 1.4), 0)
    driver.search(Pose(2.0, 1.0, 1.4), 2.0)
    assert driver.drive.left_rad == pytest.approx(1.0)
    path = np.array([[2.0, 1.0], [5.0, 1.0]])
    driver.follow(path)
    path[:] = 9.0  # it was copied
    assert driver.step(Pose(2.0, 1.0, 0.0), 1)[0].speed > 0.0
    assert driver.remaining(Pose(2.5, 1.1, 0.0)).tolist() == [[2.5, 1.1], [5.0, 1.0]]
    driver.search(pose, 2.0)
    assert not driver.following and driver.drive.left_rad == 2.0


@settings(max_examples=40, deadline=None)
@given(path=st.lists(places, min_size=1, max_size=4), theta=st.floats(-4.0, 4.0))
def test_every_way_point_of_any_path_is_reached_in_order_and_the_robot_stays_near_the_path(
    path: list[tuple[float, float]], theta: float
) -> None:
    corners = np.array([(0.0, 0.0), *path])
    poses, commands = drive(corners, Pose(0.0, 0.0, theta))
    assert (commands[:, 0] >= 0.0).all() and (np.abs(commands) <= [ROBOT.speed, ROBOT.turn_rate]).all()
    positions = poses[:, :2]
    assert off_path(positions, corners).max() < 0.1
    at = 0
    for point in path:
        near = np.flatnonzero(np.linalg.norm(positions[at:] - point, axis=1) <= FOLLOW.distance_slack_m)
        assert len(near), f"{point} was passed over"
        at += int(near[0])


def off_path(points: Array, corners: Array) -> Array:
    """Distance of each of (N, 2) points from the polyline (M, 2)."""
    start, along = corners[:-1], np.diff(corners, axis=0)
    squared = np.maximum((along**2).sum(axis=1), 1e-300)
    t = np.clip(((points[:, None] - start) * along).sum(axis=2) / squared, 0.0, 1.0)
    return np.asarray(np.linalg.norm(points[:, None] - start - t[:, :, None] * along, axis=2).min(axis=1))


@pytest.mark.parametrize("control_period_s", [0.1, 0.5, 2.0])
def test_a_slow_control_loop_overshoots_no_way_point(control_period_s: float) -> None:
    robot = RobotConfig(control_period_s=control_period_s)
    exact = FollowConfig(heading_slack_rad=1e-6, distance_slack_m=1e-6)
    poses, _ = drive(np.array([[0.0, 0.0], [1.3, 0.0], [1.3, 0.7]]), Pose(), exact, robot)
    assert poses[:, 0].max() == pytest.approx(1.3, abs=1e-5)
    assert poses[-1, :2] == pytest.approx([1.3, 0.7], abs=1e-5)
