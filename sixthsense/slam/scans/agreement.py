"""Agreement of two scans at a relative pose, by sight and by lines.

A return of one scan agrees by sight with another scan that saw a surface there. It contradicts one that saw through its
place. It says nothing where the other scan saw nothing, or is blocked by something nearer. By lines it agrees as much
as it lies on the line of the surface that was seen there.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numba

from sixthsense.core.geometry import Array
from sixthsense.core.returns import cell_of
from sixthsense.core.se2 import between, inverse, triple
from sixthsense.slam.scans.alignment import NORMALS_AGREE, SCALE_M, SURFACE_M, Views
from sixthsense.slam.scans.returns import Returns, bearings_at

LEAST_RETURNS = 20
"""fewer are no evidence"""


class Agreement(NamedTuple):
    """Numbers of returns."""

    lines: float
    """sum of the weights of those on lines"""
    hits: float
    """where the other scan saw a surface"""
    through: float
    """where the other scan saw through"""
    total: float
    """of the scan"""


@numba.njit(cache=True, error_model="numpy")
def contradicted(hits: float, through: float) -> float:
    """Share of the returns that are seen through, of those that are judged; 0 where these are too few."""
    return through / (hits + through) if hits + through >= LEAST_RETURNS else 0.0


@numba.njit(cache=True, error_model="numpy")
def agreement(returns: Returns, target: int, source: int, pose: tuple[float, float, float]) -> Agreement:
    """Agreement of the returns of `source`, at `pose` in the frame of `target`, with what `target` saw."""
    points, own, seen = returns.points, bearings_at(returns, source), bearings_at(returns, target)
    c, s = math.cos(pose[2]), math.sin(pose[2])
    lines = hits = through = count = 0.0
    for k in range(0, own.beams, own.stride):
        if points[source, k, 2] == 0.0:
            continue
        count += 1.0
        px, py = points[source, k, 0], points[source, k, 1]
        x, y = pose[0] + c * px - s * py, pose[1] + s * px + c * py
        distance = math.sqrt(x * x + y * y)
        centre = math.floor(cell_of(seen, math.atan2(y, x)) + 0.5)
        if not seen.closed and (centre < 1 or centre >= seen.beams - 1):
            continue
        gap, shortest, nearest, found = math.inf, math.inf, math.inf, -1
        for beam in range(centre - 1, centre + 2):
            q = beam % seen.beams
            r = points[target, q, 2]
            if r > 0.0:
                dx, dy = x - points[target, q, 0], y - points[target, q, 1]
                apart = math.sqrt(dx * dx + dy * dy)
                if apart < nearest:
                    nearest, found = apart, q
                gap, shortest = min(gap, apart, abs(distance - r)), min(shortest, r)
        if gap < SURFACE_M:
            hits += 1.0
            lines += _on_line(returns, target, found, x, y, (source, k, c, s))
        elif shortest < math.inf and distance < shortest - 2.0 * SURFACE_M:
            through += 1.0
    return Agreement(lines, hits, through, count)


@numba.njit(cache=True, error_model="numpy")
def _on_line(returns: Returns, target: int, q: int, x: float, y: float, point: tuple[int, int, float, float]) -> float:
    """Weight of a point at (x, y) on the line of return q of `target`; `point` is its scan, its cell and its turn."""
    (source, k, c, s), normals = point, returns.normals
    nx, ny, mx, my = normals[target, q, 0], normals[target, q, 1], normals[source, k, 0], normals[source, k, 1]
    if nx == 0.0 and ny == 0.0:
        return 0.0
    if (mx != 0.0 or my != 0.0) and (c * mx - s * my) * nx + (s * mx + c * my) * ny < NORMALS_AGREE:
        return 0.0
    r = nx * (x - returns.points[target, q, 0]) + ny * (y - returns.points[target, q, 1])
    return 1.0 / (1.0 + (r / SCALE_M) ** 2) if abs(r) < SURFACE_M else 0.0


@numba.njit(cache=True, error_model="numpy")
def agreement_of(views: Views, pose: Array) -> Agreement:
    """Agreement, the mean of both ways, of a scan at `pose` (3,) with that other one on whose lines most returns lie.

    The others may have seen other sides of what it sees.
    """
    best = Agreement(0.0, 0.0, 0.0, 0.0)
    for r in range(len(views.targets)):
        seen = between(triple(views.at[r]), triple(pose))
        there = agreement(views.returns, views.targets[r], views.source, seen)
        back = agreement(views.returns, views.source, views.targets[r], inverse(seen))
        lines, hits = 0.5 * (there.lines + back.lines), 0.5 * (there.hits + back.hits)
        if r == 0 or lines > best.lines:
            best = Agreement(lines, hits, 0.5 * (there.through + back.through), 0.5 * (there.total + back.total))
    return best
