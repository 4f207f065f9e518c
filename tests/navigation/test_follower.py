import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sixthsense.config import Config, FollowConfig, RobotConfig
from sixthsense.core.geometry import Array, Pose, wrap_angle
from sixthsense.core.motion import rk4
from sixthsense.core.source import Command
from sixthsense.navigation.path_driver import Following, FollowLimits, followed

FOLLOW, ROBOT = FollowConfig(), RobotConfig()


class Follower:
    """Follows a path tick by tick, as a drive does."""

    def __init__(self, follow: FollowConfig, robot: RobotConfig) -> None:
        self._limits = FollowLimits.of(Config(follow=follow, robot=robot))
        self.follow(np.zeros((0, 2)))

    def follow(self, path: Array) -> None:
        self._following = Following.along(path)

    def remaining(self, pose: Pose) -> Array:
        return self._following.remaining(pose)

    def step(self, pose: Pose) -> Command:
        speed, turn_rate, k, is_driving = followed((pose.x, pose.y, pose.theta), self._following, self._limits)
        self._following = Following(self._following.path, k, is_driving)
        return Command(speed, turn_rate)


places = st.tuples(st.floats(-5.0, 5.0), st.floats(-5.0, 5.0))


def drive(
    follower: Follower, pose: Pose, robot: RobotConfig = ROBOT, ticks: int = 20_000
) -> list[tuple[Pose, Command]]:
    """Poses before, and commands of, each tick of a drive without noise, until the follower stands still."""
    rows = []
    for _ in range(ticks):
        command = follower.step(pose)
        rows.append((pose, command))
        if command == Command():
            return rows
        pose = rk4(pose, command.speed, command.turn_rate, robot.control_period_s, robot.integration_step_s)
    raise AssertionError("the follower never stood still")


def test_without_a_path_the_robot_stands_still() -> None:
    follower = Follower(FOLLOW, ROBOT)
    assert follower.step(Pose(1.0, 2.0, 0.3)) == Command()
    for path in (np.zeros((0, 2)), np.array([[1.0, 2.0]])):
        follower.follow(path)
        assert follower.step(Pose(1.0, 2.0, 0.3)) == Command()


def test_it_orients_on_the_spot_and_then_translates() -> None:
    follower = Follower(FOLLOW, ROBOT)
    follower.follow(np.array([[0.0, 0.0], [0.0, 2.0]]))
    rows = drive(follower, Pose())
    turning = [command.speed == 0.0 and command.turn_rate != 0.0 for _, command in rows[:-1]]
    first = turning.index(False)
    assert all(turning[:first])
    assert not any(turning[first:])
    assert rows[first][0].position == pytest.approx([0.0, 0.0])
    assert abs(wrap_angle(rows[first][0].theta - math.pi / 2)) <= FOLLOW.heading_slack_rad


@pytest.mark.parametrize("goal", [(-1.0, 1e-3), (-1.0, -1e-3)])
def test_it_turns_in_the_direction_of_the_smaller_angle(goal: tuple[float, float]) -> None:
    follower = Follower(FOLLOW, ROBOT)
    follower.follow(np.array([(0.0, 0.0), goal]))
    assert math.copysign(1.0, follower.step(Pose()).turn_rate) == math.copysign(1.0, goal[1])


@settings(max_examples=40, deadline=None)
@given(path=st.lists(places, min_size=1, max_size=4), theta=st.floats(-4.0, 4.0))
def test_every_way_point_of_any_path_is_reached_in_order_within_the_limits(
    path: list[tuple[float, float]], theta: float
) -> None:
    follower = Follower(FOLLOW, ROBOT)
    follower.follow(np.array([(0.0, 0.0), *path]))
    rows = drive(follower, Pose(0.0, 0.0, theta))
    for _, command in rows:
        assert 0.0 <= command.speed <= ROBOT.speed
        assert abs(command.turn_rate) <= ROBOT.turn_rate
    positions = np.array([pose.position for pose, _ in rows])
    at = 0
    for point in path:
        near = np.flatnonzero(np.linalg.norm(positions[at:] - point, axis=1) <= FOLLOW.distance_slack_m)
        assert len(near), f"{point} was passed over"
        at += int(near[0])
    assert len(follower.remaining(rows[-1][0])) == 1


@settings(max_examples=25, deadline=None)
@given(path=st.lists(places, min_size=1, max_size=3), theta=st.floats(-4.0, 4.0))
def test_without_noise_the_robot_stays_near_its_path(path: list[tuple[float, float]], theta: float) -> None:
    follower = Follower(FOLLOW, ROBOT)
    corners = np.array([(0.0, 0.0), *path])
    follower.follow(corners)
    positions = np.array([pose.position for pose, _ in drive(follower, Pose(0.0, 0.0, theta))])
    assert off_path(positions, corners).max() < 0.1


def off_path(points: Array, corners: Array) -> Array:
    """Distance of each of (N, 2) points from the polyline (M, 2)."""
    start, along = corners[:-1], np.diff(corners, axis=0)
    squared = np.maximum((along**2).sum(axis=1), 1e-300)
    t = np.clip(((points[:, None] - start) * along).sum(axis=2) / squared, 0.0, 1.0)
    return np.asarray(np.linalg.norm(points[:, None] - start - t[:, :, None] * along, axis=2).min(axis=1))


@pytest.mark.parametrize("seed", range(10))
def test_it_arrives_in_spite_of_noise_on_the_motion(seed: int) -> None:
    rng = np.random.default_rng(seed)
    follower = Follower(FOLLOW, ROBOT)
    follower.follow(np.concatenate([np.zeros((1, 2)), rng.uniform(-3.0, 3.0, (3, 2))]))
    pose = Pose()
    for _ in range(10_000):
        command = follower.step(pose)
        if command == Command():
            break
        v, w = command.speed * (1.0 + 0.2 * rng.standard_normal()), command.turn_rate + 0.05 * rng.standard_normal()
        pose = rk4(pose, v, w, ROBOT.control_period_s)
    assert len(follower.remaining(pose)) == 1


@pytest.mark.parametrize("control_period_s", [0.1, 0.5, 2.0])
def test_a_slow_control_loop_overshoots_no_way_point(control_period_s: float) -> None:
    robot = RobotConfig(control_period_s=control_period_s)
    follower = Follower(FollowConfig(heading_slack_rad=1e-6, distance_slack_m=1e-6), robot)
    follower.follow(np.array([[0.0, 0.0], [1.3, 0.0], [1.3, 0.7]]))
    poses = [pose for pose, _ in drive(follower, Pose(), robot)]
    assert max(pose.x for pose in poses) == pytest.approx(1.3, abs=1e-5)
    assert poses[-1].position == pytest.approx([1.3, 0.7], abs=1e-5)


def test_a_new_path_replaces_the_old_one() -> None:
    follower = Follower(FOLLOW, ROBOT)
    follower.follow(np.array([[0.0, 0.0], [5.0, 0.0]]))
    follower.step(Pose())
    follower.follow(np.array([[0.0, 0.0], [0.0, 1.0]]))
    assert drive(follower, Pose())[-1][0].position == pytest.approx([0.0, 1.0], abs=2 * FOLLOW.distance_slack_m)


def test_the_path_given_is_copied_and_what_remains_starts_at_the_robot() -> None:
    follower = Follower(FOLLOW, ROBOT)
    path = np.array([[0.0, 0.0], [1.0, 0.0], [2.0, 0.0]])
    follower.follow(path)
    path[:] = 9.0
    remaining = follower.remaining(Pose(0.5, 0.1, 0.0))
    assert remaining.tolist() == [[0.5, 0.1], [1.0, 0.0], [2.0, 0.0]]
    remaining[:] = 9.0
    assert follower.remaining(Pose()).tolist() == [[0.0, 0.0], [1.0, 0.0], [2.0, 0.0]]
