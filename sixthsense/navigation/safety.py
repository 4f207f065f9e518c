"""The guard: every command passes it on the way to the drive; one that would touch what the laser sees does not.

It knows no map and no pose: the latest scan's returns, moved by the odometry since, the disc that the robot is, and how
it brakes. A disc that turns on the spot touches nothing, so turning is always allowed.
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
_STRAIGHT = 1e-6  # an arc that bends this little within a radius is a line


def stopping_distance(speed: float, latency_s: float, deceleration: float) -> float:
    """Metres from the moment an obstacle appears, seen `latency_s` later, to standstill; m/s and m/s^2."""
    return speed * latency_s + 0.5 * speed * speed / deceleration


def latency_s(config: Config) -> float:
    """Longest time from what happens to the command that answers it: a scan's period and a control tick."""
    return (config.laser.period_ticks + 1) * config.robot.control_period_s


@numba.njit(cache=True, error_model="numpy")
def _limits(
    points: Array, tx: float, ty: float, theta: float, speed: float, turn_rate: float, radius: float, reach: float
) -> tuple[float, float]:
    """Way to the first touch along the arc of a command, and the gap to the nearest return that lies ahead; metres.

    Returns (N, 2) `points` in a frame in which the robot, a disc of `radius`, stands at (tx, ty, theta). Either is inf
    where it would be more than `reach`.
    """
    c, s = math.cos(theta), math.sin(theta)
    forward = 1.0 if speed > 0.0 else -1.0
    curvature = abs(turn_rate / speed)
    side = 1.0 if turn_rate > 0.0 else -1.0  # the arc seen along the motion, mirrored to a left turn
    way, gap = np.inf, np.inf
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
                way = 0.0
            continue  # or else the motion leaves it
        if curvature * radius < _STRAIGHT:
            if ahead > 0.0 and abs(left) < radius:
                way = min(way, ahead - math.sqrt(radius * radius - left * left))
            continue
        # The centre moves on a circle about (0, r): it touches where its distance is down to `radius`.
        r = 1.0 / curvature
        rho = math.hypot(ahead, r - left)
        if abs(rho - r) < radius and rho > 0.0:
            at = math.atan2(ahead, r - left) % (2.0 * math.pi)
            half = math.acos(min(max((r * r + rho * rho - radius * radius) / (2.0 * r * rho), -1.0), 1.0))
            way = min(way, r * ((at - half) % (2.0 * math.pi)))
    return way if way <= reach else np.inf, gap


@numba.njit(cache=True, error_model="numpy")
def _returns(
    ranges: NDArray[np.float32], bearings: Array, max_range: float, mx: float, my: float, mtheta: float
) -> Array:
    """(K, 2) the beams' ends that are returns, in the frame in which the laser stands at (mx, my, mtheta)."""
    points = np.empty((len(ranges), 2))
    k = 0
    for i in range(len(ranges)):
        if 0.0 < ranges[i] < max_range:
            points[k, 0] = mx + ranges[i] * math.cos(bearings[i] + mtheta)
            points[k, 1] = my + ranges[i] * math.sin(bearings[i] + mtheta)
            k += 1
    return points[:k]


class Guard:
    """Slows commands so that the robot can stop before what it sees, and stops those that would touch it."""

    def __init__(self, config: Config, radius_m: float) -> None:
        """Guard a robot that is a disc of `radius_m`."""
        self.stops = 0
        """how often a moving robot was stopped"""
        self._config = config
        self._radius_m = radius_m + config.safety.buffer_m
        self._latency_s = latency_s(config)
        self._scan: Scan | None = None
        self._points = np.zeros((0, 2))  # returns in the robot's frame at the latest scan
        self._since = Pose()
        self._stopped = False

    def moved(self, motion: Pose) -> None:
        """Take in the motion of a control tick, by odometry: `T_before_after`."""
        self._since = self._since @ motion

    def see(self, scan: Scan) -> None:
        """Take in a scan, taken where the robot is now."""
        self._scan, self._since = scan, Pose()

    @property
    def blocked(self) -> bool:
        """Whether the latest command was stopped."""
        return self._stopped

    def check(self, command: Command) -> Command:
        """The command, slowed or stopped if need be; its turn rate is never touched when it stands still.

        Two laws bound the speed v, d(v) being the stopping distance. On the way: d(v) is at most the way that the
        disc, with its buffer, can go along the command's arc before it touches a return; where that is not even d of
        creep speed the robot stops. Beside: d(v) is at most the gap to the nearest return in the half plane ahead, so
        that the robot stands before it reaches it, wherever it heads meanwhile; but creep speed is always left, or a
        narrow door would be closed.
        """
        if command.speed == 0.0 or not self._config.safety.guard:
            self._stopped = False
            return command
        if self._scan is not None:
            scan, mount = self._scan, self._scan.T_robot_laser
            self._points = _returns(scan.ranges, scan.bearings, scan.max_range, mount.x, mount.y, mount.theta)
            self._scan = None
        since, speed = self._since, abs(command.speed)
        reach = stopping_distance(speed, self._latency_s, self._config.robot.deceleration)
        way, gap = _limits(
            self._points, since.x, since.y, since.theta, command.speed, command.turn_rate, self._radius_m, reach
        )
        creep = min(self._config.safety.creep, speed)
        limit = self._within(way)
        stopped = limit < creep
        self.stops += stopped and not self._stopped
        self._stopped = stopped
        if stopped:
            return Command(0.0, command.turn_rate)
        limit = min(limit, max(self._within(gap), creep))
        if limit >= speed:
            return command
        # On the same arc, slower.
        return Command(command.speed * limit / speed, command.turn_rate * limit / speed)

    def _within(self, distance_m: float) -> float:
        """The speed whose stopping distance is `distance_m`, m/s."""
        if not 0.0 < distance_m < math.inf:
            return max(distance_m, 0.0)
        delay = self._config.robot.deceleration * self._latency_s
        return math.sqrt(delay * delay + 2.0 * self._config.robot.deceleration * distance_m) - delay
