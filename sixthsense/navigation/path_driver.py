"""Driving to one place: plan, follow, plan again when the path is blocked, and turn around while there is no path.

A path is followed by turns on the spot and straight lines: orient, then translate (report section 4.4).
"""

from __future__ import annotations

import math
from typing import Literal, NamedTuple, Protocol

import numba
import numpy as np

from sixthsense.config import Config
from sixthsense.config.sections import GOAL_SLACK_M
from sixthsense.core.geometry import Array, Pose
from sixthsense.core.se2 import Triple, wrapped
from sixthsense.core.source import Command
from sixthsense.navigation.centring import centred
from sixthsense.navigation.path_planner import DrivingMap, PathPlanner
from sixthsense.navigation.planners.shortcut import path_is_free

DriveEvent = Literal["arrived", "turned around", "stuck"]
"""arrived: at the goal, on every tick there; turned around: a turn on the spot is complete, where people are expected
several, and no path was found during it; stuck: no progress for a while."""

PATIENT_TURNS = 5
"""turns on the spot, half a minute, that a robot without a way waits for people to go"""
_PROGRESS_M = 2.0 * GOAL_SLACK_M  # of a robot that is not stuck
_REORIENT = 5.0  # the robot stops and turns on the spot at this multiple of the heading slack


class FollowLimits(NamedTuple):
    """How precisely a path is followed, and how fast."""

    distance_slack_m: float
    heading_slack_rad: float
    speed: float
    """m/s"""
    turn_rate: float
    """rad/s"""
    period_s: float
    """of a control tick"""

    @staticmethod
    def of(config: Config) -> FollowLimits:
        """Those of a configuration."""
        follow, robot = config.follow, config.robot
        return FollowLimits(
            float(follow.distance_slack_m),
            float(follow.heading_slack_rad),
            float(robot.speed),
            float(robot.turn_rate),
            float(robot.control_period_s),
        )


class Following(NamedTuple):
    """A path, and how far the robot has come on it."""

    path: Array
    """(N, 2) way points, metres, world frame; the first one is where the robot was"""
    next: int
    """index of the way point ahead"""
    is_driving: bool
    """whether it drives towards it, else it turns towards it"""

    @staticmethod
    def along(path_world: Array) -> Following:
        """At the begin of a path (N, 2)."""
        return Following(np.array(path_world, dtype=np.float64, order="C"), 1, False)

    def remaining(self, pose: Pose) -> Array:
        """(M, 2): the robot's position and the way points ahead."""
        return np.vstack([pose.position, self.path[self.next :]])


@numba.njit(cache=True, error_model="numpy")
def followed(pose: Triple, following: Following, limits: FollowLimits) -> tuple[float, float, int, bool]:
    """Speed and turn rate of one control tick, then the next way point and whether the robot drives towards it.

    A standstill when no way point is left.
    """
    path, k, is_driving = following.path, following.next, following.is_driving
    x, y, distance = 0.0, 0.0, 0.0
    while k < len(path):
        x, y = path[k, 0] - pose[0], path[k, 1] - pose[1]
        distance = math.hypot(x, y)
        if distance > limits.distance_slack_m:
            break
        k += 1
        is_driving = False
    if k >= len(path):
        return 0.0, 0.0, k, is_driving
    error = wrapped(math.atan2(y, x) - pose[2])
    if is_driving and abs(error) > _REORIENT * limits.heading_slack_rad:
        is_driving = False
    if not is_driving:
        if abs(error) > limits.heading_slack_rad:
            return 0.0, _clip(error / limits.period_s, limits.turn_rate), k, is_driving
        is_driving = True
    # A small turn rate corrects drift while driving. One tick never overshoots the way point.
    turn_rate = _clip(2.0 * error * limits.speed / max(distance, 0.25), limits.turn_rate)
    return min(limits.speed, distance / limits.period_s), turn_rate, k, is_driving


@numba.njit(cache=True, error_model="numpy")
def _clip(value: float, limit: float) -> float:
    return min(max(value, -limit), limit)


class Mission(Protocol):
    """Decides where to drive."""

    def handle(self, event: DriveEvent, pose: Pose) -> bool:
        """React to an event, perhaps with another goal; whether the mission is over."""
        ...


class DriverLimits(NamedTuple):
    """When a drive to a goal needs more than a command, and how fast the robot turns on the spot."""

    goal_slack_m: float
    patience_ns: float
    """time without progress after which the robot is stuck"""
    turn_rate: float
    """rad/s"""
    follow: FollowLimits

    @staticmethod
    def of(config: Config) -> DriverLimits:
        """Those of a configuration: a robot is stuck after twice the time of its patient turns and of some progress."""
        robot = config.robot
        patience_s = 2.0 * (PATIENT_TURNS * math.tau / robot.turn_rate + _PROGRESS_M / robot.speed)
        follow = FollowLimits.of(config)
        return DriverLimits(GOAL_SLACK_M, patience_s * 10**9, float(robot.turn_rate), follow)


class GoalDrive(NamedTuple):
    """A drive to a goal, as it changes tick by tick."""

    goal: tuple[float, float]
    is_following: bool
    """whether there is a path that is being followed"""
    following: Following
    is_turning: bool
    """whether the robot turns on the spot, as long as there is no path"""
    heading: float
    """at the last tick of that turn"""
    left_rad: float
    """still to be turned"""
    is_watched: bool
    """whether there is a place since which progress is watched"""
    anchor: tuple[int, float, float]
    """stamp (ns) and that place"""

    @staticmethod
    def towards(goal: tuple[float, float]) -> GoalDrive:
        """One that stands, without a path yet."""
        return GoalDrive(goal, False, Following(np.zeros((0, 2)), 0, False), False, 0.0, 0.0, False, (0, 0.0, 0.0))


STEERED, STUCK, TURNED = range(3)
"""what a control tick has come to"""


@numba.njit(cache=True, error_model="numpy")
def is_there(drive: GoalDrive, pose: Triple, limits: DriverLimits) -> bool:
    """Whether the robot is at the goal."""
    return math.hypot(pose[0] - drive.goal[0], pose[1] - drive.goal[1]) <= limits.goal_slack_m


@numba.njit(cache=True, error_model="numpy")
def advanced(
    drive: GoalDrive, pose: Triple, stamp_ns: int, limits: DriverLimits
) -> tuple[GoalDrive, float, float, int]:
    """The drive after a control tick that does not end at the goal, speed, turn rate and what the tick has come to."""
    is_watched, anchor, following, heading, left_rad = (
        drive.is_watched, drive.anchor, drive.following, drive.heading, drive.left_rad,
    )  # fmt: skip
    is_turning, speed, turn_rate, event = drive.is_turning, 0.0, 0.0, STEERED
    if not is_watched or math.hypot(pose[0] - anchor[1], pose[1] - anchor[2]) > _PROGRESS_M:
        is_watched, anchor = True, (stamp_ns, pose[0], pose[1])
    elif stamp_ns - anchor[0] > limits.patience_ns:
        is_watched, event = False, STUCK
    if event == STEERED and drive.is_following:
        speed, turn_rate, k, is_driving = followed(pose, following, limits.follow)
        following = Following(following.path, k, is_driving)
    elif event == STEERED and is_turning:
        left_rad -= abs(wrapped(pose[2] - heading))
        heading, is_turning = pose[2], left_rad > 0.0
        turn_rate, event = (limits.turn_rate, STEERED) if is_turning else (0.0, TURNED)
    after = GoalDrive(drive.goal, drive.is_following, following, is_turning, heading, left_rad, is_watched, anchor)
    return after, speed, turn_rate, event


class PathDriver:
    """Drives the robot to a goal: along a path, or turning on the spot while there is none.

    A blocked path may be due to a single wrong return, which more scans will clear: hence the turn.
    """

    def __init__(self, map_: DrivingMap, pose: Pose, goal: Array, planner: PathPlanner, config: Config) -> None:
        """Stand at `pose` with the goal (2,), without a path yet."""
        self.limits = DriverLimits.of(config)
        """when a tick needs more than a command"""
        self.drive = GoalDrive.towards((float(goal[0]), float(goal[1])))
        """the state that control ticks change"""
        self._planner = planner
        self._patience_rad = math.tau * (PATIENT_TURNS if config.people else 1)
        self.update_map(map_, pose)

    @property
    def goal(self) -> Array:
        """(2,) the place to drive to, world frame."""
        return np.array(self.drive.goal)

    @property
    def following(self) -> bool:
        """Whether there is a path that is being followed."""
        return self.drive.is_following

    def update_map(self, map_: DrivingMap, pose: Pose) -> None:
        """Take in another map."""
        self._map = map_
        self.space = map_.free_space(0.0, np.array([pose.position, self.goal]), None)
        """where the robot may drive, without a margin"""
        self._centre(pose)

    def _centre(self, pose: Pose) -> None:
        """Lead the path ahead through the middle of gaps, as far as they are known now."""
        if self.following:
            path = centred(self._map.grid, self.space, self.drive.following.remaining(pose))
            if path is not None:
                self.drive = self.drive._replace(following=Following.along(path))

    def head_for(self, goal: Array, pose: Pose) -> None:
        """Plan a path to another goal (2,) and follow it."""
        self.drive = self.drive._replace(goal=(float(goal[0]), float(goal[1])), is_watched=False)
        self.space = self.space.covering(pose.position, goal)
        self.plan(pose)

    def plan(self, pose: Pose) -> None:
        """Plan a path to the goal and follow it; without a path, turn around."""
        path = self._planner.plan(self._map, self.space, pose.position, self.goal)
        if path is None:
            self.guard_stopped(pose)
        else:
            self.drive = self.drive._replace(is_following=True, following=Following.along(path), is_turning=False)
            self._centre(pose)

    def path_is_free(self, pose: Pose) -> bool:
        """Whether there is a path and the rest of it is free."""
        return self.following and path_is_free(self.space, self.drive.following.remaining(pose))

    def remaining_m(self, pose: Pose) -> float:
        """Length of the rest of the path; infinite without one."""
        if not self.following:
            return math.inf
        steps = np.diff(self.drive.following.remaining(pose), axis=0)
        return float(np.hypot(steps[:, 0], steps[:, 1]).sum())

    def ahead(self, pose: Pose, length_m: float) -> Array:
        """(2, 2) half and all of so many metres along the rest of the path; none without one."""
        if not self.following:
            return np.zeros((0, 2))
        way = self.drive.following.remaining(pose)
        along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(way, axis=0).T))])
        return np.column_stack([np.interp([0.5 * length_m, length_m], along, way[:, axis]) for axis in (0, 1)])

    def stop(self) -> None:
        """Drop the path, and end a turn."""
        self.drive = self.drive._replace(is_following=False, is_turning=False)

    def turn_around(self, pose: Pose, angle_rad: float) -> None:
        """Drop the path and turn on the spot."""
        self.drive = self.drive._replace(is_following=False, is_turning=True, heading=pose.theta, left_rad=angle_rad)

    def wait(self, pose: Pose) -> None:
        """Drop the path and turn around once: who is in the way may go."""
        self.drive = self.drive._replace(is_watched=False)
        self.turn_around(pose, math.tau)

    def guard_stopped(self, pose: Pose) -> None:
        """Drop the path and turn, until a keyframe has brought the obstacle into the map and a new path avoids it."""
        if self.drive.is_turning:
            self.drive = self.drive._replace(is_following=False)
        else:
            self.turn_around(pose, self._patience_rad)

    def step(self, pose: Pose, stamp_ns: int, mission: Mission) -> Command:
        """The command of a control tick, after `mission` has handled the events."""
        place = pose.x, pose.y, pose.theta
        if is_there(self.drive, place, self.limits) and mission.handle("arrived", pose):
            return Command()
        self.drive, speed, turn_rate, event = advanced(self.drive, place, stamp_ns, self.limits)
        if event == STUCK:
            mission.handle("stuck", pose)
            self.drive, speed, turn_rate, event = advanced(self.drive, place, stamp_ns, self.limits)
        if event == TURNED:
            mission.handle("turned around", pose)
        return Command(speed, turn_rate)
