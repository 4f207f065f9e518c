"""The laser scanner: scans, their beams' angles and times."""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from sixthsense.config import LaserConfig
from sixthsense.core.geometry import Array, Pose
from sixthsense.core.returns import Bearings, bearings_of, by_bearing, normals_of

MOST_RANGE_M = 100.0
"""Lasers with two dimensions reach 10 to 80 m, the largest 250 m, and see most walls well below."""


@dataclass(frozen=True, slots=True)
class Sweep:
    """Bearings and noise of a scan that was de-skewed."""

    bearings: Array
    """(N,) radians in the laser's frame at the scan's stamp, no longer evenly spaced"""
    closed: bool
    """whether the first beam still follows the last"""
    cov: Array
    """(3, 3) of the odometry over the sweep, from the tick at or before its begin; axes of the robot at the stamp"""
    lags: Array
    """(N,) time from each beam to the stamp, as a share of the time that `cov` covers"""


@dataclass(frozen=True)
class Scan:
    """One turn of the laser; ranges and angles are float32, so that a recorded scan is replayed exactly.

    Its returns are computed once, when they are first read: as points, one for each beam, and by bearing, with normals.
    """

    ranges: NDArray[np.float32]
    """(N,) metres, inf for no return"""
    angle_min: np.float32
    """bearing of the first beam in the laser's frame, radians"""
    angle_increment: np.float32
    """between two beams, radians"""
    max_range: float
    """metres"""
    T_robot_laser: Pose = Pose()
    """mount"""
    time_increment: np.float32 = np.float32(0.0)
    """seconds from beam to beam, negative if the last was taken first; 0: all at the scan's stamp"""
    sweep: Sweep | None = None
    """of a scan that was de-skewed: its bearings and noise"""

    @classmethod
    def from_config(cls, ranges: Array, config: LaserConfig) -> Scan:
        """Make a scan of the configured beams from (N,) ranges in metres; at or beyond the maximum means no return."""
        rounded = np.asarray(ranges, dtype=np.float32)
        rounded = np.where(rounded < np.float32(config.max_range), rounded, np.float32(np.inf))
        rounded.flags.writeable = False
        angle_min, increment = beam_angles(config)
        lag = time_increment(config)
        return cls(rounded, angle_min, increment, config.max_range, Pose(*config.mount), lag)

    @property
    def bearings(self) -> Array:
        """(N,) radians in the laser's frame, not wrapped; ascending evenly from `angle_min`, unless de-skewed."""
        if self.sweep is not None:
            return self.sweep.bearings
        return np.asarray(float(self.angle_min) + float(self.angle_increment) * np.arange(len(self.ranges)))

    @property
    def closed(self) -> bool:
        """Whether the first beam follows the last."""
        if self.sweep is not None:
            return self.sweep.closed
        return abs(len(self.ranges) * float(self.angle_increment) - 2 * math.pi) < 0.5 * float(self.angle_increment)

    @property
    def times_s(self) -> Array:
        """(N,) seconds, at most 0, of each beam relative to the scan's stamp, which is that of the latest beam."""
        return sweep_times(len(self.ranges), self.time_increment)

    def mirrored(self) -> Scan:
        """The scan of a laser that exchanges left and right, of beams with even spacing."""
        last = float(self.angle_min) + float(self.angle_increment) * (len(self.ranges) - 1)
        ranges = self.ranges[::-1].copy()
        ranges.flags.writeable = False
        return replace(self, ranges=ranges, angle_min=np.float32(-last), time_increment=-self.time_increment)

    @functools.cached_property
    def is_return(self) -> NDArray[np.bool_]:
        """(N,) whether a beam has a return: a range above 0 and below the maximum."""
        return np.asarray((self.ranges > 0.0) & (self.ranges < self.max_range))

    @functools.cached_property
    def points_laser(self) -> Array:
        """(N, 2) metres in the laser's frame, by beam; infinite or NaN for a beam without a return."""
        bearings, ranges = self.bearings, self.ranges.astype(np.float64)
        with np.errstate(invalid="ignore"):
            return _read_only(np.stack([ranges * np.cos(bearings), ranges * np.sin(bearings)], axis=1))

    @functools.cached_property
    def points_robot(self) -> Array:
        """(N, 2) the same in the robot's frame."""
        with np.errstate(invalid="ignore"):
            return _read_only(self.T_robot_laser @ self.points_laser)

    @functools.cached_property
    def returns_robot(self) -> Array:
        """(K, 2) metres in the robot's frame: the points of the beams with a return."""
        return _read_only(self.points_robot[self.is_return])

    @functools.cached_property
    def cells(self) -> Bearings:
        """The cells of its beams, which are of equal angle where the beams of a sweep are not."""
        return bearings_of(float(self.angle_min), float(self.angle_increment), len(self.ranges), self.closed)

    @functools.cached_property
    def by_bearing(self) -> NDArray[np.float32]:
        """(cells, 3) x, y and range of the return in each cell, metres, laser's frame; see `returns.by_bearing`."""
        return by_bearing(self.ranges, self.bearings, self.cells, float(self.max_range))

    @functools.cached_property
    def normals(self) -> NDArray[np.float32]:
        """(cells, 3) normal of the surface there, towards the laser, and its angle's variance, rad^2; or 0."""
        return normals_of(self.by_bearing, self.cells)


def _read_only(array: Array) -> Array:
    array.flags.writeable = False
    return array


def beam_angles(config: LaserConfig) -> tuple[np.float32, np.float32]:
    """First bearing and spacing, float32 radians; a full circle has no beam that repeats the first."""
    full = config.fov > 2 * math.pi - 1e-9
    spacing = config.fov / (config.beams if full else config.beams - 1)
    return np.float32(-config.fov / 2), np.float32(spacing)


def time_increment(config: LaserConfig) -> np.float32:
    """Seconds from beam to beam, float32."""
    return np.float32(config.sweep_s / config.beams)


def sweep_times(beams: int, increment: np.float32) -> Array:
    """(N,) seconds, at most 0, of each beam relative to the latest one."""
    times = float(increment) * np.arange(beams)
    return np.asarray(times - max(times[-1], 0.0))


def sweep_ns(beams: int, increment: np.float32) -> int:
    """Nanoseconds, at most 0, of the earliest beam relative to the latest one."""
    return round(1e9 * float(sweep_times(beams, increment).min()))


def beam_bearings(config: LaserConfig) -> Array:
    """(N,) bearings of the configured beams in the laser's frame, radians."""
    return Scan.from_config(np.ones(config.beams), config).bearings
