"""Agreement of a scan with others at a pose, by visibility: seen on a surface, seen through, or not seen.

A return of one scan agrees with another scan that saw a surface there. It contradicts one that saw through its place.
It says nothing where the other scan saw nothing, or is blocked by something nearer.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numba
import numpy as np

from sixthsense.core.geometry import Array
from sixthsense.slam.scans.alignment import NORMALS_AGREE, SCALE_M, SURFACE_M, Views, partner
from sixthsense.slam.scans.returns import Returns, bearings_at, cell_of, direction

_LEAST_JUDGED = 15.0  # returns; a scan of which less is judged is no evidence

UNSEEN, THROUGH, SURFACE = range(3)


class Agreement(NamedTuple):
    """Returns that agree and that contradict, of both sides, halved."""

    hits: float
    violations: float

    @property
    def share(self) -> float:
        """Share of the violations in what is judged; 0 where nothing is."""
        return contradicted(self.hits, self.violations)


@numba.njit(cache=True, error_model="numpy")
def contradicted(hits: float, violations: float) -> float:
    """Share of the violations in what is judged; 0 where that is too little to be evidence."""
    return violations / (hits + violations) if hits + violations >= _LEAST_JUDGED else 0.0


@numba.njit(cache=True, error_model="numpy")
def look_at(returns: Returns, target: int, x: float, y: float) -> int:
    """What `target` saw at (x, y) in its frame: `SURFACE`, `THROUGH` or `UNSEEN`."""
    points, bearings = returns.points, bearings_at(returns, target)
    distance = math.sqrt(x * x + y * y)
    centre = math.floor(cell_of(bearings, direction(x, y)) + 0.5)
    if not bearings.closed and (centre < 1 or centre >= bearings.beams - 1):
        return UNSEEN
    gap, shortest = math.inf, math.inf
    for beam in range(centre - 1, centre + 2):
        q = beam % bearings.beams
        r = points[target, q, 2]
        if r > 0.0:
            dx, dy = x - points[target, q, 0], y - points[target, q, 1]
            gap = min(gap, math.sqrt(dx * dx + dy * dy), abs(distance - r))
            shortest = min(shortest, r)
    if gap < SURFACE_M:
        return SURFACE
    if shortest < math.inf and distance < shortest - 2.0 * SURFACE_M:
        return THROUGH
    return UNSEEN


@numba.njit(cache=True, error_model="numpy")
def judged(views: Views, pose: Array) -> tuple[float, float]:
    """Hits and violations of a scan at `pose` (3,) among others, both ways.

    A return of the source counts once: as a hit if any target saw a surface there, else as a violation if any saw
    through. Those of the targets count by 1 / R.
    """
    returns, source, targets, at = views.returns, views.source, views.targets, views.at
    points, bearings = returns.points, bearings_at(returns, source)
    state = np.zeros(bearings.beams, np.int64)
    hits, violations = 0.0, 0.0
    for r in range(len(targets)):
        target = targets[r]
        c, s = math.cos(at[r, 2]), math.sin(at[r, 2])
        dx, dy = pose[0] - at[r, 0], pose[1] - at[r, 1]
        x, y, turn = c * dx + s * dy, c * dy - s * dx, pose[2] - at[r, 2]
        c, s = math.cos(turn), math.sin(turn)
        for k in range(0, bearings.beams, bearings.stride):
            px, py = points[source, k, 0], points[source, k, 1]
            if points[source, k, 2] > 0.0 and state[k] < 2:
                state[k] = max(state[k], look_at(returns, target, x + c * px - s * py, y + s * px + c * py))
        seen = bearings_at(returns, target)
        for k in range(0, seen.beams, seen.stride):
            if points[target, k, 2] > 0.0:
                px, py = points[target, k, 0] - x, points[target, k, 1] - y
                saw = look_at(returns, source, c * px + s * py, c * py - s * px)
                if saw == 2:
                    hits += 1.0 / len(targets)
                elif saw == 1:
                    violations += 1.0 / len(targets)
    for k in range(0, bearings.beams, bearings.stride):
        if state[k] == 2:
            hits += 1.0
        elif state[k] == 1:
            violations += 1.0
    return 0.5 * hits, 0.5 * violations


@numba.njit(cache=True, error_model="numpy")
def compare_views(returns: Returns, target: int, source: int, pose: Array) -> tuple[int, int, int]:
    """Hits, violations and number of the returns of `source`, at `pose` (3,) in the frame of `target`, one way."""
    points, bearings = returns.points, bearings_at(returns, source)
    c, s = math.cos(pose[2]), math.sin(pose[2])
    hits = violations = count = 0
    for k in range(0, bearings.beams, bearings.stride):
        if points[source, k, 2] == 0.0:
            continue
        count += 1
        px, py = points[source, k, 0], points[source, k, 1]
        saw = look_at(returns, target, pose[0] + c * px - s * py, pose[1] + s * px + c * py)
        hits += saw == SURFACE
        violations += saw == THROUGH
    return hits, violations, count


@numba.njit(cache=True, error_model="numpy")
def on_line(returns: Returns, target: int, source: int, k: int, turn: float, x: float, y: float) -> float:
    """Weight of point k of `source`, at (x, y) and turned by `turn`, on the nearest line of `target`; 0 for none."""
    points, normals = returns.points, returns.normals
    q = partner(returns, target, x, y, SURFACE_M)
    if q < 0:
        return 0.0
    dx, dy = x - points[target, q, 0], y - points[target, q, 1]
    nx, ny, mx, my = normals[target, q, 0], normals[target, q, 1], normals[source, k, 0], normals[source, k, 1]
    if nx == 0.0 and ny == 0.0:
        r = math.hypot(dx, dy)
    else:
        c, s = math.cos(turn), math.sin(turn)
        if (mx != 0.0 or my != 0.0) and (c * mx - s * my) * nx + (s * mx + c * my) * ny < NORMALS_AGREE:
            return 0.0
        r = abs(nx * dx + ny * dy)
    return 1.0 / (1.0 + (r / SCALE_M) ** 2) if r < SURFACE_M else 0.0


@numba.njit(cache=True, error_model="numpy")
def explained(returns: Returns, target: int, source: int, pose: Array) -> Array:
    """(3,) points of `source`, at `pose` (3,), that lie on lines of `target`, that `target` must see, and all.

    The first is a sum of weights. A point well behind a return is hidden from the target. One a little behind it, or
    before it, is contradicted.
    """
    points, bearings, seen = returns.points, bearings_at(returns, source), bearings_at(returns, target)
    c, s = math.cos(pose[2]), math.sin(pose[2])
    total = np.zeros(3)
    for k in range(0, bearings.beams, bearings.stride):
        if points[source, k, 2] == 0.0:
            continue
        total[2] += 1.0
        x = pose[0] + c * points[source, k, 0] - s * points[source, k, 1]
        y = pose[1] + s * points[source, k, 0] + c * points[source, k, 1]
        weight = on_line(returns, target, source, k, pose[2], x, y)
        centre = math.floor(cell_of(seen, math.atan2(y, x)) + 0.5)
        farthest = 0.0
        for beam in range(centre - 1, centre + 2):
            if seen.closed or 0 <= beam < seen.beams:
                farthest = max(farthest, points[target, beam % seen.beams, 2])
        if weight > 0.0 or (farthest > 0.0 and math.hypot(x, y) < farthest + 2.0 * SURFACE_M):
            total[0] += weight
            total[1] += 1.0
    return total
