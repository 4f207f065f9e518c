"""The guard: slows or stops every command by which the robot would touch a return of the latest scans.

It uses neither map nor pose, only the returns of the scans of the last second, the odometry since, the robot's disc and
its deceleration. From the latest scan the robot keeps a buffer. Its beams pass the end of a thin wall that they look
along; the scans before, from elsewhere, have met it. A disc that turns on the spot touches nothing, so it may always
turn.
"""

from __future__ import annotations

import math
from collections import deque
from typing import NamedTuple

import numba
import numpy as np

from sixthsense.config import Config
from sixthsense.core.geometry import Array, Pose
from sixthsense.core.laser import Scan, beam_bearings
from sixthsense.core.se2 import Triple, compose
from sixthsense.core.source import Command
from sixthsense.slam.mapping.mapper import BODY_M

BUFFER_M = 0.02
"""added to the robot's radius: twice the noise of a range, and the slip of a robot that turns"""
CREEP = 0.1
"""lowest speed, m/s, to which obstacles beside the robot's arc slow it: it stops within a tick"""
REMEMBERED_S = 1.0
"""of scans before the latest one, whose returns the robot does not touch"""
_NOTHING = np.zeros((0, 2))


class GuardLimits(NamedTuple):
    """What the guard allows a robot."""

    is_on: bool
    radius_m: float
    """of the robot's disc, with the buffer"""
    radius_to_earlier_m: float
    """the same towards returns of earlier scans, without: of many noisy returns the nearest is too near"""
    radius_to_bodies_m: float
    """the same towards what moves"""
    latency_s: float
    """longest time from an event to the command that reacts to it"""
    deceleration: float
    """of braking, m/s^2"""
    creep: float
    """speed at which it passes narrow places, m/s"""


class Obstacles(NamedTuple):
    """Returns about the robot, metres; in its frame at the latest scan if not said."""

    points: Array
    """(N, 2) all returns"""
    moving: Array
    """(M, 2) those that move"""
    earlier: Array
    """(K, 2) those near the robot of the scans before, in the frame of the guard's odometry"""


@numba.njit(cache=True, error_model="numpy")
def stopping_distance(speed: float, latency_s: float, deceleration: float) -> float:
    """Distance, metres, from the moment an obstacle appears to standstill; m/s and m/s^2.

    The robot begins to brake `latency_s` later.
    """
    return speed * latency_s + 0.5 * speed * speed / deceleration


def latency_s(config: Config) -> float:
    """Longest time from an event to the command that reacts to it: a scan's period and a control tick."""
    return (config.laser.period_ticks + 1) * config.robot.control_period_s


def least_clearance_m(radius_m: float, config: Config) -> float:
    """The distance, m, from obstacles to the centre of a disc below which a path may not lead.

    It is the guard's own, if beams cover the half circle ahead, and lie no farther apart than the buffer at its edge.
    Other robots keep `grid.clearance_m`, or the buffer if that is larger.
    """
    laser = config.laser
    spacing = abs(float(np.subtract(*beam_bearings(laser)[:2])))
    is_around = laser.fov >= math.pi and spacing * (radius_m + BUFFER_M) <= BUFFER_M
    sees_beside = config.safety.guard and is_around
    return radius_m + (BUFFER_M if sees_beside else max(config.grid.clearance_m, BUFFER_M))


@numba.njit(cache=True, error_model="numpy")
def _contact_and_gap(
    points: Array, tx: float, ty: float, theta: float, speed: float, turn_rate: float, radius: float, reach: float
) -> tuple[float, float]:
    """Distance to the first contact along a command's arc, and gap to the nearest return ahead; metres.

    `points` (N, 2) are the returns, in a frame in which the robot, a disc of `radius`, stands at (tx, ty, theta). Each
    result is inf if it would be more than `reach`.
    """
    c, s = math.cos(theta), math.sin(theta)
    forward = 1.0 if speed > 0.0 else -1.0
    curvature = abs(turn_rate / speed)
    side = 1.0 if turn_rate > 0.0 else -1.0  # mirrors the arc, seen along the motion, to a left turn
    contact, gap = np.inf, np.inf
    farthest_sq = (radius + reach) ** 2
    for i in range(len(points)):
        dx, dy = points[i, 0] - tx, points[i, 1] - ty
        if dx * dx + dy * dy > farthest_sq:
            continue
        ahead, left = forward * (c * dx + s * dy), side * forward * (c * dy - s * dx)
        distance = math.hypot(ahead, left)
        if ahead > 0.0:
            gap = min(gap, distance - radius)
        if distance <= radius:
            if ahead > 0.0:
                contact = 0.0
            continue  # else the robot moves away from it
        # The centre moves on a circle around (0, 1 / curvature), from which the return is 1 / curvature + off away. The
        # contact is where the centre's distance to the return is `radius`.
        away = math.hypot(curvature * ahead, 1.0 - curvature * left)
        off = (curvature * distance * distance - 2.0 * left) / (1.0 + away)
        if abs(off) >= radius or away == 0.0:
            continue
        chord = math.sqrt((radius * radius - off * off) / away)
        if curvature > 0.0:
            at = math.atan2(curvature * ahead, 1.0 - curvature * left)
            half = 2.0 * math.asin(min(0.5 * curvature * chord, 1.0))
            contact = min(contact, (at - half) % (2.0 * math.pi) / curvature)
        elif ahead > 0.0:
            contact = min(contact, ahead - chord)
    return contact if contact <= reach else np.inf, gap


@numba.njit(cache=True, error_model="numpy")
def _speed_within(distance_m: float, limits: GuardLimits) -> float:
    """The speed whose stopping distance is `distance_m`, m/s."""
    if not 0.0 < distance_m < math.inf:
        return max(distance_m, 0.0)
    delay = limits.deceleration * limits.latency_s
    return math.sqrt(delay * delay + 2.0 * limits.deceleration * distance_m) - delay


@numba.njit(cache=True, error_model="numpy")
def checked(
    command: tuple[float, float],
    since: Triple,
    at: Triple,
    obstacles: Obstacles,
    limits: GuardLimits,
) -> tuple[float, float, bool, bool]:
    """Speed and turn rate of a command, slowed or stopped as `Guard.check` says, and whether it was stopped.

    `since` is the motion since the latest scan, and `at` the robot's pose in the frame of the guard's odometry. The
    last result says whether what moves is nearest in the way.
    """
    v, w = command
    if not limits.is_on:
        return v, w, False, False
    x, y, theta = since
    speed = abs(v)
    reach = stopping_distance(speed, limits.latency_s, limits.deceleration)
    contact, gap = _contact_and_gap(obstacles.points, x, y, theta, v, w, limits.radius_m, reach)
    x, y, theta = at
    contact = min(contact, _contact_and_gap(obstacles.earlier, x, y, theta, v, w, limits.radius_to_earlier_m, reach)[0])
    x, y, theta = since
    waits_for_moving = False
    if len(obstacles.moving):
        to_body, body_gap = _contact_and_gap(obstacles.moving, x, y, theta, v, w, limits.radius_to_bodies_m, reach)
        waits_for_moving = to_body < contact
        contact, gap = min(contact, to_body), min(gap, body_gap)
    creep = min(limits.creep, speed)
    limit = _speed_within(contact, limits)
    if limit < creep:
        return 0.0, w, True, waits_for_moving
    limit = min(limit, max(_speed_within(gap, limits), creep))
    if limit >= speed:
        return v, w, False, waits_for_moving
    return v * limit / speed, w * limit / speed, False, waits_for_moving  # on the same arc, slower


class Guard:
    """Slows commands so that the robot can stop before any return, and stops those that would touch one."""

    def __init__(self, config: Config, radius_m: float) -> None:
        """Guard a robot that is a disc of `radius_m`."""
        self.stops = 0
        """how often a moving robot was stopped"""
        self.waits_for_moving = False
        """whether what moves is nearest in the way of the latest command"""
        radii = radius_m + BUFFER_M, radius_m, radius_m + BUFFER_M + BODY_M
        limits = map(float, (*radii, latency_s(config), config.robot.deceleration, CREEP))
        self.limits = GuardLimits(bool(config.safety.guard), *limits)
        """what it allows"""
        self._scan: Scan | None = None  # the latest one, until its returns are needed
        self._obstacles = Obstacles(_NOTHING, _NOTHING, _NOTHING)
        self._since: Triple = (0.0, 0.0, 0.0)
        self._at = self._since
        period_s, speed = config.laser.period_ticks * config.robot.control_period_s, float(config.robot.speed)
        count = math.ceil(REMEMBERED_S / period_s)
        self._before: deque[Array] = deque(maxlen=count)
        """(K, 2) near returns of each scan before the latest one, frame of the guard's odometry"""
        self._waiting: deque[tuple[Scan, Triple]] = deque(maxlen=count + 1)
        """scans up to the latest one whose returns were not needed yet, and where the robot stood"""
        braking_m = stopping_distance(speed, self.limits.latency_s, self.limits.deceleration)
        self._near_m = float(radius_m + braking_m + speed * REMEMBERED_S)
        """range of the earlier returns that it can touch"""
        self._stopped = False

    def moved(self, motion: Pose) -> None:
        """Add the motion of a control tick from odometry, `T_before_after`."""
        step = motion.triple()  # of triples: it is called at each control tick
        self._since, self._at = compose(self._since, step), compose(self._at, step)

    def see(self, scan: Scan, moving_robot: Array = _NOTHING) -> None:
        """Record a scan from the robot's present pose, and which of its returns (M, 2), robot's frame, move."""
        self._scan, self._since = scan, (0.0, 0.0, 0.0)
        if len(self._obstacles.moving):
            self._before.clear()  # what moves was elsewhere, and which of the earlier returns were its is not known
            self._waiting.clear()
        self._waiting.append((scan, self._at))
        self._obstacles = Obstacles(_NOTHING, np.ascontiguousarray(moving_robot), _NOTHING)

    @property
    def stopped(self) -> bool:
        """Whether the latest command was stopped."""
        return self._stopped

    def check(self, command: Command) -> Command:
        """The command, slowed or stopped if necessary; a turn on the spot is never changed.

        Two laws bound the speed v by its stopping distance d(v). Along the arc: d(v) is at most the distance that the
        disc, with its buffer, can move along the command's arc before it touches a return. If that is less than d of
        creep speed, the robot stops. In any direction: d(v) is at most the gap to the nearest return in the half plane
        ahead, so that the robot can stop before it, however it turns meanwhile. This law leaves at least creep speed,
        or the robot could not pass a narrow door.
        """
        if command.speed == 0.0:
            self._stopped = False
            return command
        before = self._stopped
        asked = float(command.speed), float(command.turn_rate)
        found = checked(asked, self._since, self._at, self.obstacles(), self.limits)
        speed, turn_rate, self._stopped, self.waits_for_moving = found
        self.stops += self._stopped and not before
        return Command(speed, turn_rate)

    def obstacles(self) -> Obstacles:
        """The returns of the latest scan and of those before."""
        if self._scan is not None:
            scan, self._scan = self._scan, None
            while len(self._waiting) > 1:
                before, at = self._waiting.popleft()
                near = before.returns_robot[np.linalg.norm(before.returns_robot, axis=1) < self._near_m]
                self._before.append(Pose(*at) @ near)
            self._obstacles = Obstacles(
                scan.returns_robot.copy(), self._obstacles.moving, np.concatenate([_NOTHING, *self._before])
            )
        return self._obstacles
