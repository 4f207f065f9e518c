"""The guard: slows or stops every command by which the robot would touch a return of the latest scan.

It uses neither map nor pose, only the returns of the latest scan, the odometry since, the robot's disc and its
deceleration. A disc that turns on the spot touches nothing, so turning is always allowed.
"""

from __future__ import annotations

import math

import numba
import numpy as np
from numpy.typing import NDArray

from sixthsense.config import Config
from sixthsense.core.geometry import Array, Pose
from sixthsense.core.laser import Scan
from sixthsense.core.source import Command

_TOUCH = 1e-9  # metres
_NOTHING = np.zeros((0, 2))
_STRAIGHT = 1e-6  # an arc with a smaller product of curvature and radius is treated as a line


def stopping_distance(speed: float, latency_s: float, deceleration: float) -> float:
    """Distance, metres, from the moment an obstacle appears to standstill; m/s and m/s^2.

    The robot begins to brake `latency_s` later.
    """
    return speed * latency_s + 0.5 * speed * speed / deceleration


def latency_s(config: Config) -> float:
    """Longest time from an event to the command that reacts to it: a scan's period and a control tick."""
    return (config.laser.period_ticks + 1) * config.robot.control_period_s


@numba.njit(cache=True, error_model="numpy")
def _limits(
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
        if distance <= radius + _TOUCH:
            if ahead > 0.0:
                contact = 0.0
            continue  # else the robot moves away from it
        if curvature * radius < _STRAIGHT:
            if ahead > 0.0 and abs(left) < radius:
                contact = min(contact, ahead - math.sqrt(radius * radius - left * left))
            continue
        # The centre moves on a circle around (0, r). The contact is where its distance to the return is `radius`.
        r = 1.0 / curvature
        rho = math.hypot(ahead, r - left)
        if abs(rho - r) < radius and rho > 0.0:
            at = math.atan2(ahead, r - left) % (2.0 * math.pi)
            half = math.acos(min(max((r * r + rho * rho - radius * radius) / (2.0 * r * rho), -1.0), 1.0))
            contact = min(contact, r * ((at - half) % (2.0 * math.pi)))
    return contact if contact <= reach else np.inf, gap


@numba.njit(cache=True, error_model="numpy")
def _return_points(
    ranges: NDArray[np.float32], bearings: Array, max_range: float, mx: float, my: float, mtheta: float
) -> Array:
    """(K, 2) the returns, in the frame in which the laser stands at (mx, my, mtheta)."""
    points = np.empty((len(ranges), 2))
    k = 0
    for i in range(len(ranges)):
        if 0.0 < ranges[i] < max_range:
            points[k, 0] = mx + ranges[i] * math.cos(bearings[i] + mtheta)
            points[k, 1] = my + ranges[i] * math.sin(bearings[i] + mtheta)
            k += 1
    return points[:k]


class Guard:
    """Slows commands so that the robot can stop before any return, and stops those that would touch one."""

    def __init__(self, config: Config, radius_m: float) -> None:
        """Guard a robot that is a disc of `radius_m`."""
        self.stops = 0
        """how often a moving robot was stopped"""
        self.waits_for_moving = False
        """whether what moves is nearest in the way of the latest command"""
        self._config = config
        self._radius_m = radius_m + config.safety.buffer_m
        self._latency_s = latency_s(config)
        self._scan: Scan | None = None
        self._points = np.zeros((0, 2))  # returns in the robot's frame at the latest scan
        self._moving = _NOTHING
        self._since = Pose()
        self._stopped = False

    def moved(self, motion: Pose) -> None:
        """Take in the motion of a control tick from odometry, `T_before_after`."""
        self._since = self._since @ motion

    def see(self, scan: Scan, moving_robot: Array = _NOTHING) -> None:
        """Take in a scan from the robot's present pose, and those of its returns (M, 2), robot's frame, that move."""
        self._scan, self._since, self._moving = scan, Pose(), moving_robot

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
        if command.speed == 0.0 or not self._config.safety.guard:
            self._stopped = False
            return command
        if self._scan is not None:
            scan, mount = self._scan, self._scan.T_robot_laser
            self._points = _return_points(scan.ranges, scan.bearings, scan.max_range, mount.x, mount.y, mount.theta)
            self._scan = None
        since, speed = self._since, abs(command.speed)
        reach = stopping_distance(speed, self._latency_s, self._config.robot.deceleration)
        contact, gap = _limits(
            self._points, since.x, since.y, since.theta, command.speed, command.turn_rate, self._radius_m, reach
        )
        self.waits_for_moving = False
        if len(self._moving):
            wide_m = self._radius_m + self._config.safety.body_m
            to_body = _limits(
                self._moving, since.x, since.y, since.theta, command.speed, command.turn_rate, wide_m, reach
            )
            self.waits_for_moving = to_body[0] < contact
            contact, gap = min(contact, to_body[0]), min(gap, to_body[1])
        creep = min(self._config.safety.creep, speed)
        limit = self._speed_within(contact)
        stopped = limit < creep
        self.stops += stopped and not self._stopped
        self._stopped = stopped
        if stopped:
            return Command(0.0, command.turn_rate)
        limit = min(limit, max(self._speed_within(gap), creep))
        if limit >= speed:
            return command
        # On the same arc, slower.
        return Command(command.speed * limit / speed, command.turn_rate * limit / speed)

    def _speed_within(self, distance_m: float) -> float:
        """The speed whose stopping distance is `distance_m`, m/s."""
        if not 0.0 < distance_m < math.inf:
            return max(distance_m, 0.0)
        delay = self._config.robot.deceleration * self._latency_s
        return math.sqrt(delay * delay + 2.0 * self._config.robot.deceleration * distance_m) - delay
