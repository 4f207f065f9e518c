"""The laser scanner: scans, their beams' angles and times, and ray casting."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from sixthsense.config import LaserConfig
from sixthsense.core.geometry import Array, Pose

_JOIN = 1e-9  # share of its length by which a wall is extended, so that two walls that join leave no gap


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


@dataclass(frozen=True, slots=True)
class Scan:
    """One turn of the laser; ranges and angles are float32, so that a recorded scan is replayed exactly."""

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

    @property
    def points_robot(self) -> Array:
        """(N, 2) metres in the robot's frame; infinite or NaN for a beam without a return."""
        bearings = self.bearings
        ranges = self.ranges.astype(np.float64)
        with np.errstate(invalid="ignore"):
            points_laser = np.stack([ranges * np.cos(bearings), ranges * np.sin(bearings)], axis=1)
            return self.T_robot_laser @ points_laser


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
    if increment == 0.0:
        return 0
    return round(1e9 * float(sweep_times(beams, increment).min()))


def beam_bearings(config: LaserConfig) -> Array:
    """(N,) bearings of the configured beams in the laser's frame, radians."""
    angle_min, increment = beam_angles(config)
    return np.asarray(float(angle_min) + float(increment) * np.arange(config.beams))


@numba.njit(cache=True, error_model="numpy", fastmath={"nsz", "contract", "arcp"})
def _cast_rays(x: float, y: float, cos: Array, sin: Array, walls: Array, max_range: float, ranges: Array) -> None:
    """Fill `ranges` (N,) with the distance along each direction to the nearest of `walls` (M, 4), inf beyond range."""
    ranges[:] = np.inf
    for j in range(walls.shape[0]):
        ax, ay = walls[j, 0] - x, walls[j, 1] - y
        ex, ey = walls[j, 2] - walls[j, 0], walls[j, 3] - walls[j, 1]
        length_sq = ex * ex + ey * ey
        # A wall out of range costs one distance instead of one test per beam.
        s = min(max(-(ax * ex + ay * ey) / length_sq, 0.0), 1.0)
        nx, ny = ax + s * ex, ay + s * ey
        if nx * nx + ny * ny > max_range * max_range:
            continue
        across = ax * ey - ay * ex
        for i in range(ranges.shape[0]):
            # x + t d = a + u e, by Cramer's rule.
            inverse = 1.0 / (cos[i] * ey - sin[i] * ex)
            t = across * inverse
            u = (ax * sin[i] - ay * cos[i]) * inverse
            if t >= 0.0 and u >= -_JOIN and u <= 1.0 + _JOIN and t < ranges[i]:
                ranges[i] = t
    for i in range(ranges.shape[0]):
        if ranges[i] >= max_range:
            ranges[i] = np.inf


@numba.njit(cache=True, error_model="numpy")
def _cast_sweep(x: Array, y: Array, cos: Array, sin: Array, walls: Array, max_range: float, ranges: Array) -> None:
    """As `_cast_rays`, with a position for each beam."""
    for i in range(ranges.shape[0]):
        _cast_rays(x[i], y[i], cos[i : i + 1], sin[i : i + 1], walls, max_range, ranges[i : i + 1])


def cast_sweep(poses: Array, bearings: Array, walls: Array, max_range: float) -> Array:
    """As `cast_rays` for a moving laser: beam i is cast from row i of `poses` (N, 3), world frame."""
    angles = bearings + poses[:, 2]
    ranges = np.empty(len(angles))
    x, y = np.ascontiguousarray(poses[:, 0]), np.ascontiguousarray(poses[:, 1])
    flat = np.ascontiguousarray(walls.reshape(-1, 4))
    _cast_sweep(x, y, np.cos(angles), np.sin(angles), flat, max_range, ranges)
    return ranges


def cast_rays(T_world_laser: Pose, bearings: Array, walls: Array, max_range: float) -> Array:
    """Distances from the laser to the nearest wall along each bearing.

    `bearings` (N,) radians in the laser's frame, `walls` (M, 2, 2) segments in the world's, metres. Returns (N,)
    metres, inf where no wall is nearer than `max_range`.
    """
    angles = bearings + T_world_laser.theta
    ranges = np.empty(len(angles))
    flat = np.ascontiguousarray(walls.reshape(-1, 4))
    _cast_rays(T_world_laser.x, T_world_laser.y, np.cos(angles), np.sin(angles), flat, max_range, ranges)
    return ranges


def hit_walls(T_world_laser: Pose, bearings: Array, walls: Array, max_range: float) -> tuple[Array, NDArray[np.int64]]:
    """Ranges as `cast_rays` returns them, and (N,) the index of the wall that each beam hits, -1 for none.

    Where two walls are hit at the same distance, the first is taken. It is slower than `cast_rays` and meant for
    evaluation.
    """
    ranges, index = np.full(len(bearings), np.inf), np.full(len(bearings), -1, dtype=np.int64)
    if not len(walls) or not len(bearings):
        return ranges, index
    angles = bearings + T_world_laser.theta
    cos, sin = np.cos(angles), np.sin(angles)  # (N,)
    ax, ay = (walls[:, 0] - T_world_laser.position).T[:, :, None]  # (M, 1)
    ex, ey = (walls[:, 1] - walls[:, 0]).T[:, :, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        # x + t d = a + u e, by Cramer's rule.
        inverse = 1.0 / (cos * ey - sin * ex)  # (M, N)
        t, u = (ax * ey - ay * ex) * inverse, (ax * sin - ay * cos) * inverse
        t[~((t >= 0.0) & (u >= -_JOIN) & (u <= 1.0 + _JOIN) & (t < max_range))] = np.inf
    nearest = t.argmin(axis=0)
    ranges = t[nearest, np.arange(len(bearings))]
    index = np.where(np.isfinite(ranges), nearest, index)
    return ranges, index
