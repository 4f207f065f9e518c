"""What the scans of keyframes say of each other: seen, seen through, or nothing.

A return of one scan is confirmed by another scan that saw a surface there, and contradicted by one that saw through its
place.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from sixthsense.core.geometry import Array
from sixthsense.core.laser import Scan
from sixthsense.core.se2 import between, compose

RETURNS = 60
"""of a scan that are compared, evenly spread over its beams"""
FEWEST = 15
"""returns that must be judged for a comparison to say anything"""
_SURFACE_M, _M_PER_M = 0.12, 0.01  # a return is on a surface nearer than this, and what the heading adds per metre
BACK_M = (2.0, 5.0, 10.0)
"""travel before a keyframe at which keyframes lie that it is compared with"""
NEXT = 3
"""keyframes before each that it is compared with, too"""
_AROUND_M, _AROUND, _MOST_OLD = 4.0, 40, 4  # how near places of other passes are, how many are looked at, and compared
APART_M = 10.0
"""of travel between two passes of one place"""

SURFACE, THROUGH, ALL = range(3)
"""columns of a comparison"""


class Views(NamedTuple):
    """The scans of K keyframes; those without one have no returns."""

    ranges: NDArray[np.float32]
    """(K, B) m; 0 for no return"""
    fans: Array
    """(K, 3) bearing of the first beam, spacing, number of beams"""
    closed: NDArray[np.bool_]
    """(K,) whether the first beam follows the last"""
    points: Array
    """(K, RETURNS, 2) some returns, laser's frame; NaN where there are fewer"""
    mounts: Array
    """(K, 3) pose of the laser in the robot's frame"""

    @property
    def returns(self) -> NDArray[np.int64]:
        """(K,) number of returns of each scan."""
        return np.asarray((self.ranges > 0.0).sum(axis=1), dtype=np.int64)


def views_of(scans: Sequence[Scan | None]) -> Views:
    """The scans, packed."""
    count, beams = len(scans), max((len(scan.ranges) for scan in scans if scan is not None), default=1)
    ranges, fans = np.zeros((count, beams), np.float32), np.zeros((count, 3))
    closed, points, mounts = np.zeros(count, np.bool_), np.full((count, RETURNS, 2), np.nan), np.zeros((count, 3))
    for k, scan in enumerate(scans):
        if scan is None or not len(scan.ranges):
            continue
        own, bearings = scan.ranges, scan.bearings
        returned = np.flatnonzero(scan.is_return)
        ranges[k, returned] = own[returned]
        spacing = (bearings[-1] - bearings[0]) / max(len(own) - 1, 1)
        fans[k], closed[k] = (bearings[0], spacing, len(own)), scan.closed
        mounts[k] = scan.T_robot_laser.array()
        if len(returned):
            kept = returned[np.unique(np.linspace(0, len(returned) - 1, RETURNS).astype(np.int64))]
            at = np.stack([np.cos(bearings[kept]), np.sin(bearings[kept])], axis=1)
            points[k, : len(kept)] = own[kept, None] * at
    return Views(ranges, fans, closed, points, mounts)


def compared(views: Views, poses: Array, pairs: NDArray[np.int64]) -> NDArray[np.int64]:
    """(m, 3) returns of both keyframes of `pairs` (m, 2) that the other has judged; `poses` (K, 3) of the robot."""
    if not len(pairs):
        return np.zeros((0, 3), np.int64)
    lasers = compose(poses, views.mounts)
    both = (pairs, pairs[:, ::-1])
    there, back = (compared_at(views, each, between(*lasers[each.T])) for each in both)
    return there + back


def compared_at(views: Views, pairs: NDArray[np.int64], motions: Array) -> NDArray[np.int64]:
    """(m, 3) returns of the second keyframes judged by the first, if the lasers moved by `motions` (m, 3)."""
    found = np.zeros((len(pairs), 3), np.int64)
    _compare_all(views, np.ascontiguousarray(pairs), np.ascontiguousarray(motions), found)
    return found


@numba.njit(cache=True, error_model="numpy")
def _compare_all(views: Views, pairs: NDArray[np.int64], motions: Array, found: NDArray[np.int64]) -> None:
    """Judge returns of the second of each pair, at `motions` (m, 3) in the first one's laser frame, by the first."""
    points = views.points
    for m in range(len(pairs)):
        seer, seen = pairs[m, 0], pairs[m, 1]
        c, s = math.cos(motions[m, 2]), math.sin(motions[m, 2])
        for k in range(points.shape[1]):
            px, py = points[seen, k, 0], points[seen, k, 1]
            if not math.isfinite(px):
                break
            found[m, ALL] += 1
            beyond = beyond_m(views, seer, motions[m, 0] + c * px - s * py, motions[m, 1] + s * px + c * py)
            if beyond == 0.0:
                found[m, SURFACE] += 1
            elif beyond > 0.0:
                found[m, THROUGH] += 1


@numba.njit(cache=True, error_model="numpy")
def beyond_m(views: Views, seer: int, x: float, y: float) -> float:
    """How far a keyframe saw beyond (x, y) of its laser's frame: 0 for a surface there, -1 if it cannot tell."""
    ranges, first, spacing, count = views.ranges, views.fans[seer, 0], views.fans[seer, 1], int(views.fans[seer, 2])
    if count < 3 or spacing == 0.0:
        return -1.0
    distance, around = math.sqrt(x * x + y * y), 2.0 * math.pi / abs(spacing)
    at = (math.atan2(y, x) - first) / spacing
    at -= around * math.floor(at / around)
    centre, tolerance = math.floor(at + 0.5), _SURFACE_M + _M_PER_M * distance
    nearest, valid = math.inf, 0
    for beam in range(centre - 1, centre + 2):
        q = beam
        if views.closed[seer]:
            q = beam % count
        elif beam < 0 or beam >= count:
            continue
        r = ranges[seer, q]
        if r > 0.0:
            valid += 1
            if abs(r - distance) < tolerance:
                return 0.0
            nearest = min(nearest, r)
    if valid == 3 and nearest > distance + 2.0 * tolerance:
        return nearest - distance
    return -1.0


def travelled(trajectory: Array) -> Array:
    """(K,) m from the first keyframe to each, where a turn of a radian counts half a metre."""
    if not len(trajectory):
        return np.zeros(0)
    steps = np.diff(trajectory, axis=0)
    turns = np.abs((steps[:, 2] + np.pi) % (2.0 * np.pi) - np.pi)
    return np.concatenate([[0.0], np.cumsum(np.hypot(steps[:, 0], steps[:, 1]) + 0.5 * turns)])


def recent_pairs(travel: Array) -> NDArray[np.int64]:
    """(m, 2) an earlier keyframe, and one that is compared with it, of the 10 m after it."""
    count, pairs = len(travel), []
    own = np.arange(count)
    for back in BACK_M:
        before = np.minimum(np.searchsorted(travel, travel - back, side="left"), own - 1)
        pairs.append(np.stack([before, own], axis=1))
    pairs += [np.stack([own - back, own], axis=1) for back in range(1, NEXT + 1)]
    found = np.unique(np.concatenate(pairs), axis=0)
    found = found[found[:, 0] >= 0]
    is_near = (travel[found[:, 1]] - travel[found[:, 0]] <= BACK_M[-1] + 2.0) | (np.diff(found)[:, 0] <= NEXT)
    return np.asarray(found[is_near])


def old_pairs(trajectory: Array, travel: Array) -> NDArray[np.int64]:
    """(m, 2) each keyframe with the nearest ones that lie more than `APART_M` of travel apart, the earlier first."""
    count = len(trajectory)
    if count < 2 or travel[-1] - travel[0] <= APART_M:
        return np.zeros((0, 2), np.int64)
    from scipy.spatial import cKDTree  # here, since a run that begins need not wait for it

    tree, at = cKDTree(trajectory[:, :2]), trajectory[:, :2]
    near_m, near = map(np.asarray, tree.query(at, k=min(_AROUND, count), distance_upper_bound=_AROUND_M))
    own = np.broadcast_to(np.arange(count)[:, None], near.shape)
    is_there = np.isfinite(near_m)
    gap = np.abs(travel[np.where(is_there, near, 0)] - travel[own])
    is_old = is_there & (gap > APART_M)
    rank = np.where(is_old, np.cumsum(is_old, axis=1), 0)
    chosen = (rank >= 1) & (rank <= _MOST_OLD)
    pairs = np.stack([np.minimum(near[chosen], own[chosen]), np.maximum(near[chosen], own[chosen])], axis=1)
    return np.asarray(np.unique(pairs, axis=0), dtype=np.int64).reshape(-1, 2)
