"""How the fitted lines of a scan end: in a corner with the next line, at the wall's own free end, or undecided."""

from __future__ import annotations

import math
from typing import NamedTuple

import numba
import numpy as np

from sixthsense.core.geometry import Array
from sixthsense.slam.features.lines import FittedLines
from sixthsense.slam.features.partition import Indices

UNDECIDED, FREE_END = -1, -2
"""Endpoint types; any other is the index of the line that is met in a corner."""

_LEAST_SINE = math.sin(math.radians(25.0))
"""of the angle between the lines of a corner: the place of a flatter one is hardly determined along them"""
_RANGE_MARGIN_M = 0.2
"""rule 2: a wall that goes on beyond the maximum range ends this close to it, by the noise of a range and its slope"""


class RolledScan(NamedTuple):
    """A scan as the kernels of this room get it: laser's frame, rolled so that no partition straddles its seam."""

    points: Array
    """(N, 2) metres; the origin for a beam without a return"""
    ranges: Array
    """(N,) metres, inf for no return"""
    bearings: Array
    """(N,) radians"""
    pieces: Indices
    """(P, 2) first and past-last return of each first-level partition"""
    closed: bool
    """whether the first beam follows the last"""
    cyclic: bool
    """whether the only partition closes on itself"""


class EndpointRules(NamedTuple):
    """When a line's endpoint is a corner or a free end."""

    ends: bool
    """look for free ends"""
    max_gap_m: float
    """both lines end within this of their corner"""
    max_range_m: float
    """of the laser"""
    min_points: int
    """rule 4: returns in the partition of a free end"""
    threshold_m: float
    """greatest distance of an inlier from its line"""


@numba.njit(cache=True, error_model="numpy")
def mean_spacing(bearings: Array) -> float:
    """Mean angle between neighbouring beams, radians; the spacing of a de-skewed scan varies by a few percent."""
    spacing: float = abs(bearings[-1] - bearings[0]) / (len(bearings) - 1)
    return spacing


@numba.njit(cache=True, error_model="numpy")
def intersect(first: Array, second: Array) -> Array:
    """Intersection of two lines (5,): (5,) x, y and the entries xx, xy, yy of its covariance; NaN if parallel."""
    c1, s1, c2, s2 = math.cos(first[0]), math.sin(first[0]), math.cos(second[0]), math.sin(second[0])
    det = c1 * s2 - s1 * c2
    out = np.full(5, np.nan)
    if det == 0.0:
        return out
    x, y = (s2 * first[1] - s1 * second[1]) / det, (c1 * second[1] - c2 * first[1]) / det
    out[0], out[1] = x, y
    out[2:] = 0.0
    # Columns of the inverse of [[c1, s1], [c2, s2]]: the point's derivatives by each line's offset.
    for fit, ux, uy, arm in (
        (first, s2 / det, -c2 / det, x * s1 - y * c1),
        (second, -s1 / det, c1 / det, x * s2 - y * c2),
    ):
        var = arm * arm * fit[2] + 2.0 * arm * fit[3] + fit[4]
        out[2] += ux * ux * var
        out[3] += ux * uy * var
        out[4] += uy * uy * var
    return out


@numba.njit(cache=True, error_model="numpy")
def free_end(line: Array, bearing: float, step: float, sigma_bearing: float) -> Array:
    """Position of a wall's free end, between its last beam at `bearing` and the next beam, `step` radians on.

    Returns (5,) x, y, xx, xy, yy. The end is taken as uniform between the two beams: half a spacing beyond the last
    return, with a sigma of one spacing over sqrt(12) along the wall and that of the line across it.
    """
    end = bearing + 0.5 * step
    cosine = math.cos(end - line[0])
    out = np.full(5, np.nan)
    if cosine <= 0.0:
        return out
    r, tangent = line[1] / cosine, math.tan(end - line[0])
    c, s = math.cos(end), math.sin(end)
    out[0], out[1] = r * c, r * s
    # r = d / cos(end - alpha): its derivatives by alpha and d lie along the beam.
    radial = (r * tangent) ** 2 * line[2] - 2.0 * r * tangent / cosine * line[3] + line[4] / cosine**2
    along = step * step / 12.0 + sigma_bearing * sigma_bearing
    tx, ty = r * (tangent * c - s), r * (tangent * s + c)  # derivative by the end's bearing: along the wall
    out[2] = radial * c * c + along * tx * tx
    out[3] = radial * c * s + along * tx * ty
    out[4] = radial * s * s + along * ty * ty
    return out


@numba.njit(cache=True, error_model="numpy")
def _is_free_end(scan: RolledScan, k: int, step: int, following: int, line: Array, rules: EndpointRules) -> bool:
    """Whether a partition that ends at return k in the direction `step` (+1 or -1) shows a wall's own end.

    `following` is the next position in that direction, -1 at the edge of the field of view (rule 1 of the report).
    """
    ranges, bearings = scan.ranges, scan.bearings
    if following < 0:
        return False
    if ranges[k] > rules.max_range_m - _RANGE_MARGIN_M:  # rule 2
        return False
    if ranges[following] < ranges[k]:  # rule 3: something nearer occludes the rest
        return False
    ahead = math.cos(bearings[k] + step * mean_spacing(bearings) - line[0])
    if ahead <= 0.0 or line[1] / ahead > rules.max_range_m - _RANGE_MARGIN_M:
        return False  # rule 2 for the wall's continuation, which may lie beyond the range
    if math.isfinite(ranges[following]):
        off = ranges[following] * math.cos(bearings[following] - line[0]) - line[1]
        if abs(off) < rules.threshold_m:
            return False  # the wall continues at an incidence too flat for one partition
    return True


@numba.njit(cache=True, error_model="numpy")
def _clear_of(points: Array, index: Indices, corner: Array, radius: float) -> Indices:
    """The returns at `index` farther than `radius` from a corner; nearer ones may be of the other wall."""
    dx, dy = points[index, 0] - corner[0], points[index, 1] - corner[1]
    clear: Indices = index[dx * dx + dy * dy > radius * radius]
    return clear


@numba.njit(cache=True, error_model="numpy")
def clear_of_corners(
    points: Array, index: Indices, j: int, fits: Array, endpoint_type: Indices, sigma_range: float
) -> Indices:
    """The returns at `index`, of line j of `fits` (L, 5), that are clear of its corners in `endpoint_type` (L, 2)."""
    for side in range(2):
        other = endpoint_type[j, side]
        if other >= 0:
            turn = abs(math.sin(fits[j, 0] - fits[other, 0]))
            index = _clear_of(points, index, intersect(fits[j], fits[other]), 4.0 * sigma_range / turn)
    return index


@numba.njit(cache=True, error_model="numpy")
def mark_corners(scan: RolledScan, lines: FittedLines, rules: EndpointRules, endpoint_type: Indices) -> None:
    """Set in `endpoint_type` (L, 2) the line that each line meets in a corner at its first and its last return."""
    points, fits = scan.points, lines.fits
    count = len(fits)
    for j in range(count):
        after = j + 1
        if after == count or lines.piece[after] != lines.piece[j]:
            if not (scan.cyclic and after == count and count > 2):
                continue
            after = 0
        meet = intersect(fits[j], fits[after])
        a, b = points[lines.ends[j, 1]], points[lines.ends[after, 0]]
        near_a = math.hypot(meet[0] - a[0], meet[1] - a[1]) <= rules.max_gap_m
        near_b = math.hypot(meet[0] - b[0], meet[1] - b[1]) <= rules.max_gap_m
        if abs(math.sin(fits[j, 0] - fits[after, 0])) >= _LEAST_SINE and near_a and near_b:
            endpoint_type[j, 1], endpoint_type[after, 0] = after, j


@numba.njit(cache=True, error_model="numpy")
def mark_free_ends(scan: RolledScan, lines: FittedLines, rules: EndpointRules, endpoint_type: Indices) -> None:
    """Set `FREE_END` in `endpoint_type` (L, 2) where a line's first or last return is its wall's own end."""
    if scan.cyclic:
        return
    n = len(scan.ranges)
    for j in range(len(lines.fits)):
        piece = scan.pieces[lines.piece[j]]
        if piece[1] - piece[0] < rules.min_points:  # rule 4
            continue
        for side, k, step, last in ((0, piece[0], -1, 0), (1, piece[1] - 1, 1, n - 1)):
            following = (k + step) % n if scan.closed or k != last else -1
            if lines.ends[j, side] == k and _is_free_end(scan, k, step, following, lines.fits[j], rules):
                endpoint_type[j, side] = FREE_END
