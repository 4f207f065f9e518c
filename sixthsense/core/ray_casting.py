"""Ray casting: the range along each beam to the nearest wall or leg.

A wall or leg is tested only against the beams of the sector in which it is seen.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import ArrayLike, NDArray

from sixthsense.core.arguments import as_array, as_pose
from sixthsense.core.geometry import Array, Pose, point_segment_distance
from sixthsense.core.se2 import Triple

_JOIN = 1e-9
"""share of its length by which a wall is extended, so that two walls that join leave no gap"""
_AT_END_SQ = 4e-6
"""squared distance of the laser from a wall's end, over the squared length, below which all beams are tested"""
_SLACK_M = 2.0
"""how far the robot moves before the walls near it are found again"""
_MARGIN = 2e-6
"""quarter turns by which a sector is wider than the wall: `_JOIN` seen from an end as near as that, and rounding"""
NO_LEGS = np.zeros((0, 5))
"""legs are discs, rows of x, y, radius (m) and velocity in x and y (m/s) at the scan's stamp, world frame"""


@numba.njit(cache=True, error_model="numpy")
def _quarter_turns(x: float, y: float) -> float:
    """The direction of (x, y) from 0 to 4: ascending with its angle, and a whole number at each axis."""
    share: float = y / (abs(x) + abs(y))
    if x < 0.0:
        return 2.0 - share
    return share if y >= 0.0 else 4.0 + share


@numba.njit(cache=True, error_model="numpy")
def _sector(direction: float, n: int) -> int:
    """Which of n equal sectors a direction is in, quarter turns from -4 to 8. A branch wraps it: `%` divides."""
    if direction < 0.0:
        direction += 4.0
    elif direction >= 4.0:
        direction -= 4.0
    return min(int(direction * 0.25 * n), n - 1)


class Beams(NamedTuple):
    """Beams of a laser by sector, in its frame. There are as many sectors as beams, equal parts of `_quarter_turns`."""

    cos: Array
    """(N,) of the bearings, by sector"""
    sin: Array
    """(N,)"""
    order: NDArray[np.int64]
    """(N,) the beams' places in the scan"""
    begins: NDArray[np.int64]
    """(N + 1,) where the sectors begin"""


def beams_of(bearings: Array) -> Beams:
    """The beams at some bearings (N,), radians in the laser's frame."""
    cos, sin = np.cos(bearings), np.sin(bearings)
    order, begins = _by_sector(cos, sin)
    return Beams(cos[order], sin[order], order, begins)


@numba.njit(cache=True, error_model="numpy")
def _by_sector(cos: Array, sin: Array) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """The order and the begins of `Beams`."""
    n = len(cos)
    sectors, begins, order = np.empty(n, np.int64), np.zeros(n + 1, np.int64), np.empty(n, np.int64)
    for i in range(n):
        sectors[i] = _sector(_quarter_turns(cos[i], sin[i]), n)
        begins[sectors[i] + 1] += 1
    for k in range(n):
        begins[k + 1] += begins[k]
    places = begins[:n].copy()
    for i in range(n):
        order[places[sectors[i]]] = i
        places[sectors[i]] += 1
    return order, begins


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
def _cast_at_legs(laser: Triple, beams: Beams, legs: Array, found: Array) -> None:
    """Shorten `found` (N,) of beams to where they enter any of `legs` (L, 5)."""
    cos, sin, _, begins = beams
    n, x, y = len(cos), laser[0], laser[1]
    c, s = math.cos(laser[2]), math.sin(laser[2])
    for j in range(legs.shape[0]):
        dx, dy, radius = legs[j, 0] - x, legs[j, 1] - y, legs[j, 2]
        ax, ay = c * dx + s * dy, c * dy - s * dx
        away_sq = ax * ax + ay * ay
        # Half of the angle under which it is seen, as a tangent; a laser that is nearer than 1.4 radii tests all beams.
        if away_sq <= 2.0 * radius * radius:
            _cast_at_leg(ax, ay, radius, cos, sin, found)
            continue
        tangent = radius / math.sqrt(away_sq - radius * radius)
        begin, end = (
            _quarter_turns(ax + tangent * ay, ay - tangent * ax),
            _quarter_turns(ax - tangent * ay, ay + tangent * ax),
        )
        first, last = begins[_sector(begin - _MARGIN, n)], begins[_sector(end + _MARGIN, n) + 1]
        if begin <= end and begin >= _MARGIN and end < 4.0 - _MARGIN:
            _cast_at_leg(ax, ay, radius, cos[first:last], sin[first:last], found[first:last])
        else:
            _cast_at_leg(ax, ay, radius, cos[first:], sin[first:], found[first:])
            _cast_at_leg(ax, ay, radius, cos[:last], sin[:last], found[:last])


@numba.njit(cache=True, error_model="numpy")
def _cast_rays(laser: Triple, beams: Beams, walls: Array, legs: Array, max_range: float) -> Array:
    """(N,) the distance along each beam to the nearest of `walls` (M, 4) and `legs` (L, 5), world frame.

    It is inf where that is not nearer than `max_range`.
    """
    cos, sin, order, begins = beams
    n, found, ranges = len(cos), np.full(len(cos), np.inf), np.empty(len(cos))
    x, y, theta = laser
    c, s = math.cos(theta), math.sin(theta)
    for j in range(walls.shape[0]):
        dx, dy = walls[j, 0] - x, walls[j, 1] - y
        ax, ay = c * dx + s * dy, c * dy - s * dx  # in the frame of the laser, where the beams never change
        dx, dy = walls[j, 2] - x, walls[j, 3] - y
        bx, by = c * dx + s * dy, c * dy - s * dx
        ex, ey = bx - ax, by - ay
        length_sq = ex * ex + ey * ey
        # A wall out of range costs one distance instead of one test per beam.
        u = min(max(-(ax * ex + ay * ey) / length_sq, 0.0), 1.0)
        nx, ny = ax + u * ex, ay + u * ey
        if nx * nx + ny * ny > max_range * max_range:
            continue
        if nx * nx + ny * ny < _AT_END_SQ * length_sq:
            _cast_at_wall((ax, ay, ex, ey), cos, sin, found)
            continue
        begin, end = _quarter_turns(ax, ay), _quarter_turns(bx, by)
        if ax * by - ay * bx < 0.0:
            begin, end = end, begin
        first, last = begins[_sector(begin - _MARGIN, n)], begins[_sector(end + _MARGIN, n) + 1]
        if begin <= end and begin >= _MARGIN and end < 4.0 - _MARGIN:
            _cast_at_wall((ax, ay, ex, ey), cos[first:last], sin[first:last], found[first:last])
        else:
            _cast_at_wall((ax, ay, ex, ey), cos[first:], sin[first:], found[first:])
            _cast_at_wall((ax, ay, ex, ey), cos[:last], sin[:last], found[:last])
    _cast_at_legs(laser, beams, legs, found)
    for k in range(n):
        ranges[order[k]] = found[k] if found[k] < max_range else np.inf
    return ranges


class Moving(NamedTuple):
    """Legs during a sweep."""

    legs: Array
    """(L, 5) at the scan's stamp, as `NO_LEGS` says"""
    times_s: Array
    """(N,) of each beam relative to the stamp"""


@numba.njit(cache=True, error_model="numpy")
def _cast_sweep(poses: Array, cos: Array, sin: Array, walls: Array, moving: Moving, max_range: float) -> Array:
    """As `_cast_rays`, with a pose (N, 3) for each beam: no beams share a sector, so each is tested by itself."""
    ranges = np.full(len(cos), np.inf)
    for i in range(len(ranges)):
        x, y, found = poses[i, 0], poses[i, 1], ranges[i : i + 1]
        for j in range(len(walls)):
            ax, ay, bx, by = walls[j, 0], walls[j, 1], walls[j, 2], walls[j, 3]
            _cast_at_wall((ax - x, ay - y, bx - ax, by - ay), cos[i : i + 1], sin[i : i + 1], found)
        for j in range(len(moving.legs)):  # each has moved as its velocity says
            leg, time_s = moving.legs[j], moving.times_s[i]
            ax, ay = leg[0] + time_s * leg[3] - x, leg[1] + time_s * leg[4] - y
            _cast_at_leg(ax, ay, leg[2], cos[i : i + 1], sin[i : i + 1], found)
        if not found[0] < max_range:
            found[0] = np.inf
    return ranges


def cast_sweep(poses: Array, bearings: Array, walls: Array, max_range: float, moving: Moving | None = None) -> Array:
    """As `cast_rays` for a moving laser: beam i is cast from row i of `poses` (N, 3), world frame."""
    angles, flat = bearings + poses[:, 2], np.ascontiguousarray(walls.reshape(-1, 4))
    moving = moving or Moving(NO_LEGS, np.zeros(len(angles)))
    return _cast_sweep(np.ascontiguousarray(poses), np.cos(angles), np.sin(angles), flat, moving, max_range)


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
    laser = T_world_laser.x, T_world_laser.y, T_world_laser.theta
    return _cast_rays(laser, beams, np.ascontiguousarray(walls), legs, max_range)


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
