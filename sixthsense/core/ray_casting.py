"""Ray casting: the range along each beam to the nearest wall or leg."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import ArrayLike

from sixthsense.core.arguments import as_array, as_pose
from sixthsense.core.geometry import Array, Pose, point_segment_distance
from sixthsense.core.se2 import Triple

_JOIN = 1e-9
"""share of its length by which a wall is extended, so that two walls that join leave no gap"""
_SLACK_M = 2.0
"""how far the robot moves before the walls near it are found again"""
NO_LEGS = np.zeros((0, 5))
"""legs are discs, rows of x, y, radius (m) and velocity in x and y (m/s) at the scan's stamp, world frame"""


class Beams(NamedTuple):
    """Beams of a laser, in its frame."""

    cos: Array
    """(N,) of the bearings"""
    sin: Array
    """(N,)"""


def beams_of(bearings: Array) -> Beams:
    """The beams at some bearings (N,), radians in the laser's frame."""
    return Beams(np.cos(bearings), np.sin(bearings))


@numba.njit(cache=True, error_model="numpy", fastmath={"nsz", "contract", "arcp"})
def _cast_at_wall(wall: tuple[float, float, float, float], cos: Array, sin: Array, ranges: Array) -> None:
    """Shorten `ranges` (K,) of beams to where they hit a `wall`: its first end from the laser, and from there on."""
    ax, ay, ex, ey = wall
    across = ax * ey - ay * ex
    for i in range(ranges.shape[0]):
        # t d = a + u e, by Cramer's rule.
        inverse = 1.0 / (cos[i] * ey - sin[i] * ex)
        t = across * inverse
        u = (ax * sin[i] - ay * cos[i]) * inverse
        if t >= 0.0 and u >= -_JOIN and u <= 1.0 + _JOIN and t < ranges[i]:
            ranges[i] = t


@numba.njit(cache=True, error_model="numpy")
def _cast_at_leg(ax: float, ay: float, radius: float, cos: Array, sin: Array, ranges: Array) -> None:
    """Shorten `ranges` (K,) of beams to where they enter a leg at (ax, ay) from the laser; 0 for a laser inside it."""
    outside_sq = ax * ax + ay * ay - radius * radius
    for i in range(ranges.shape[0]):
        # |t d - a| = radius: t^2 - 2 t (a . d) + |a|^2 - radius^2 = 0
        along = ax * cos[i] + ay * sin[i]
        under = along * along - outside_sq
        if outside_sq <= 0.0:
            ranges[i] = 0.0
        elif along > 0.0 and under >= 0.0:
            ranges[i] = min(ranges[i], along - math.sqrt(under))


@numba.njit(cache=True, error_model="numpy")
def _cast_rays(laser: Triple, beams: Beams, walls: Array, legs: Array, max_range: float) -> Array:
    """(N,) the distance along each beam to the nearest of `walls` (M, 4) and `legs` (L, 5), world frame.

    It is inf where that is not nearer than `max_range`.
    """
    ranges = np.full(len(beams.cos), np.inf)
    x, y, theta = laser
    c, s = math.cos(theta), math.sin(theta)
    for j in range(walls.shape[0]):
        dx, dy = walls[j, 0] - x, walls[j, 1] - y
        ax, ay = c * dx + s * dy, c * dy - s * dx  # in the frame of the laser, where the beams never change
        dx, dy = walls[j, 2] - x, walls[j, 3] - y
        ex, ey = c * dx + s * dy - ax, c * dy - s * dx - ay
        # A wall out of range costs one distance instead of one test per beam.
        u = min(max(-(ax * ex + ay * ey) / (ex * ex + ey * ey), 0.0), 1.0)
        if (ax + u * ex) ** 2 + (ay + u * ey) ** 2 <= max_range * max_range:
            _cast_at_wall((ax, ay, ex, ey), beams.cos, beams.sin, ranges)
    for j in range(legs.shape[0]):
        dx, dy = legs[j, 0] - x, legs[j, 1] - y
        _cast_at_leg(c * dx + s * dy, c * dy - s * dx, legs[j, 2], beams.cos, beams.sin, ranges)
    for i in range(len(ranges)):
        if not ranges[i] < max_range:
            ranges[i] = np.inf
    return ranges


class Moving(NamedTuple):
    """Legs during a sweep."""

    legs: Array
    """(L, 5) at the scan's stamp, as `NO_LEGS` says"""
    times_s: Array
    """(N,) of each beam relative to the stamp"""


@numba.njit(cache=True, error_model="numpy")
def _cast_sweep(poses: Array, beams: Beams, walls: Array, moving: Moving, max_range: float) -> Array:
    """As `_cast_rays`, with a pose (N, 3) for each beam, and legs where they are then."""
    ranges, legs = np.empty(len(poses)), moving.legs.copy()
    for i in range(len(ranges)):
        for j in range(len(legs)):
            legs[j, 0] = moving.legs[j, 0] + moving.times_s[i] * legs[j, 3]
            legs[j, 1] = moving.legs[j, 1] + moving.times_s[i] * legs[j, 4]
        beam = Beams(beams.cos[i : i + 1], beams.sin[i : i + 1])
        ranges[i] = _cast_rays((poses[i, 0], poses[i, 1], poses[i, 2]), beam, walls, legs, max_range)[0]
    return ranges


def cast_sweep(poses: Array, bearings: Array, walls: Array, max_range: float, moving: Moving | None = None) -> Array:
    """As `cast_rays` for a moving laser: beam i is cast from row i of `poses` (N, 3), world frame."""
    flat, moving = np.ascontiguousarray(walls.reshape(-1, 4)), moving or Moving(NO_LEGS, np.zeros(len(poses)))
    return _cast_sweep(np.ascontiguousarray(poses), beams_of(bearings), flat, moving, max_range)


def cast_rays(T_world_laser: Pose, bearings: ArrayLike, walls: ArrayLike, max_range: float) -> Array:
    """Distances from the laser to the nearest wall along each bearing.

    `bearings` (N,) radians in the laser's frame, `walls` (M, 2, 2) segments in the world's, metres. Returns (N,)
    metres, inf where no wall is nearer than `max_range`. Raises ValueError that names the argument for other shapes,
    and for numbers that are not finite.
    """
    segments = as_array("walls", walls, ("M", 2, 2)).reshape(-1, 4)
    beams = beams_of(as_array("bearings", bearings, ("N",)))
    return cast_among(as_pose("T_world_laser", T_world_laser), beams, segments, max_range)


def cast_among(T_world_laser: Pose, beams: Beams, walls: Array, max_range: float, legs: Array = NO_LEGS) -> Array:
    """As `cast_rays`, with `walls` (M, 4) as `near_walls` finds them and `legs` (L, 5), and without checks."""
    return _cast_rays(T_world_laser.triple(), beams, np.ascontiguousarray(walls), legs, max_range)


def near_walls(walls: Array, reach_m: float) -> Callable[[float, float], Array]:
    """What finds the walls that a laser or a robot can reach from a point, anew only after it has moved a while.

    It returns (K, 4) of `walls` (M, 2, 2), metres, world frame, in their order: all that are nearer to the point than
    `reach_m`, and some that are farther.
    """
    all_walls = near = np.array(walls, dtype=np.float64).reshape(-1, 4)
    centre = (np.inf, np.inf)

    def at(x: float, y: float) -> Array:
        nonlocal centre, near
        if not math.hypot(x - centre[0], y - centre[1]) < _SLACK_M:
            centre = (x, y)
            away_m = point_segment_distance(np.array((x, y)), all_walls.reshape(-1, 2, 2))
            near = all_walls[away_m <= reach_m + _SLACK_M]
        return near

    return at
