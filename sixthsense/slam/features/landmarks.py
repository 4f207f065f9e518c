"""Landmarks of a scan: intersections of neighbouring walls and loose ends, with covariances from the fits.

Each laser return is evidence once: a wall with a landmark at both ends feeds each from the half of its returns on that
side, so that the two are independent; a wall with one landmark feeds it from all.
"""

from __future__ import annotations

import math

import numba
import numpy as np

from sixthsense.core.geometry import Array
from sixthsense.slam.features.lines import fit_line
from sixthsense.slam.features.partition import Indices

CORNER, END = 0, 1  # kinds
NOTHING, LOOSE = -1, -2  # what a line's first or last return leads to, if not a line it meets in a corner


@numba.njit(cache=True, error_model="numpy")
def mean_spacing(bearings: Array) -> float:
    """Radians from beam to beam: of a de-skewed scan they differ by a few percent."""
    spacing: float = abs(bearings[-1] - bearings[0]) / (len(bearings) - 1)
    return spacing


@numba.njit(cache=True, error_model="numpy")
def intersect(first: Array, second: Array) -> Array:
    """Where two lines (5,) meet: (5,) x, y and the entries xx, xy, yy of the covariance; NaN if parallel."""
    c1, s1, c2, s2 = math.cos(first[0]), math.sin(first[0]), math.cos(second[0]), math.sin(second[0])
    det = c1 * s2 - s1 * c2
    out = np.full(5, np.nan)
    if abs(det) < 1e-6:
        return out
    x, y = (s2 * first[1] - s1 * second[1]) / det, (c1 * second[1] - c2 * first[1]) / det
    out[0], out[1] = x, y
    out[2:] = 0.0
    # Columns of the inverse of [[c1, s1], [c2, s2]]: how the point follows each line's offset.
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
def loose_end(line: Array, bearing: float, step: float, sigma_bearing: float) -> Array:
    """The end of a wall between its last beam at `bearing` and the next, `step` radians on, that passed it by.

    Returns (5,) x, y, xx, xy, yy. Uniform between the two beams: half a spacing beyond the last return, known along the
    wall to a spacing over sqrt(12), across it as the line is.
    """
    end = bearing + 0.5 * step
    cosine = math.cos(end - line[0])
    out = np.full(5, np.nan)
    if cosine < 1e-3:
        return out
    r, tangent = line[1] / cosine, math.tan(end - line[0])
    c, s = math.cos(end), math.sin(end)
    out[0], out[1] = r * c, r * s
    # r = d / cos(end - alpha): its derivatives by alpha and d lie along the beam.
    radial = (r * tangent) ** 2 * line[2] - 2.0 * r * tangent / cosine * line[3] + line[4] / cosine**2
    along = step * step / 12.0 + sigma_bearing * sigma_bearing
    tx, ty = r * (tangent * c - s), r * (tangent * s + c)  # by the end's bearing: along the wall
    out[2] = radial * c * c + along * tx * tx
    out[3] = radial * c * s + along * tx * ty
    out[4] = radial * s * s + along * ty * ty
    return out


@numba.njit(cache=True, error_model="numpy")
def _wall_ends(
    k: int,
    step: int,
    edge: int,
    ranges: Array,
    bearings: Array,
    line: Array,
    max_range: float,
    margin: float,
    threshold: float,
) -> bool:
    """Whether a partition that ends at return k, going by `step` (+1 or -1), shows a wall's own end (report's rules).

    `edge` is the position that follows in the scan, -1 if the sensor sees no further (rule 1).
    """
    if edge < 0:
        return False
    if ranges[k] > max_range - margin:  # rule 2
        return False
    if ranges[edge] < ranges[k]:  # rule 3: something nearer hides the rest
        return False
    ahead = math.cos(bearings[k] + step * mean_spacing(bearings) - line[0])
    if ahead <= 0.0 or line[1] / ahead > max_range - margin:
        return False  # rule 2 for the wall's continuation: it may go on beyond the range
    if math.isfinite(ranges[edge]):
        off = ranges[edge] * math.cos(bearings[edge] - line[0]) - line[1]
        if abs(off) < threshold:
            return False  # the wall goes on, met too flatly for its returns to be one partition
    return True


@numba.njit(cache=True, error_model="numpy")
def _clear_of(points: Array, index: Indices, corner: Array, radius: float) -> Indices:
    """The returns at `index` farther than `radius` from a corner; nearer ones may be of the other wall."""
    dx, dy = points[index, 0] - corner[0], points[index, 1] - corner[1]
    clear: Indices = index[dx * dx + dy * dy > radius * radius]
    return clear


@numba.njit(cache=True, error_model="numpy")
def clear_of_corners(
    points: Array, mine: Indices, j: int, lines: Array, leads_to: Indices, sigma_range: float
) -> Indices:
    """The returns at `mine`, of line j, that are clear of the corners that it `leads_to` (L, 2) at its ends."""
    for side in range(2):
        other = leads_to[j, side]
        if other >= 0:
            turn = abs(math.sin(lines[j, 0] - lines[other, 0]))
            mine = _clear_of(points, mine, intersect(lines[j], lines[other]), 4.0 * sigma_range / turn)
    return mine


@numba.njit(cache=True, error_model="numpy")
def mark_corners(
    points: Array,
    piece_of_line: Indices,
    lines: Array,
    where: Indices,
    cyclic: bool,
    max_gap: float,
    min_angle: float,
    leads_to: Indices,
) -> None:
    """Set in `leads_to` (L, 2) the neighbour that each line meets in a corner at its first and its last return."""
    count = len(lines)
    for j in range(count):
        after = j + 1
        if after == count or piece_of_line[after] != piece_of_line[j]:
            if not (cyclic and after == count and count > 2):
                continue
            after = 0
        meet = intersect(lines[j], lines[after])
        a, b = points[where[j, 2]], points[where[after, 1]]
        near_a = math.hypot(meet[0] - a[0], meet[1] - a[1]) <= max_gap
        near_b = math.hypot(meet[0] - b[0], meet[1] - b[1]) <= max_gap
        if abs(math.sin(lines[j, 0] - lines[after, 0])) >= math.sin(min_angle) and near_a and near_b:
            leads_to[j, 1], leads_to[after, 0] = after, j


@numba.njit(cache=True, error_model="numpy")
def mark_ends(
    ranges: Array,
    bearings: Array,
    pieces: Indices,
    piece_of_line: Indices,
    lines: Array,
    where: Indices,
    closed: bool,
    max_range: float,
    margin: float,
    min_points: int,
    threshold: float,
    leads_to: Indices,
) -> None:
    """Set `LOOSE` in `leads_to` (L, 2) where a line's first or last return is its wall's own end."""
    n = len(ranges)
    for j in range(len(lines)):
        piece = pieces[piece_of_line[j]]
        if piece[1] - piece[0] < min_points:  # rule 4
            continue
        for side, k, step, last in ((0, piece[0], -1, 0), (1, piece[1] - 1, 1, n - 1)):
            edge = (k + step) % n if closed or k != last else -1
            if where[j, 1 + side] == k and _wall_ends(
                k, step, edge, ranges, bearings, lines[j], max_range, margin, threshold
            ):
                leads_to[j, side] = LOOSE


@numba.njit(cache=True, error_model="numpy")
def _fit_sides(
    points: Array, lines: Array, owner: Indices, leads_to: Indices, sigma_range: float, sigma_bearing: float
) -> Array:
    """(L, 2, 5): the line as each of its landmarks may use it, so that no return is used for both; NaN for none."""
    sides = np.full((len(lines), 2, 5), np.nan)
    for j in range(len(lines)):
        mine = clear_of_corners(points, np.flatnonzero(owner == j), j, lines, leads_to, sigma_range)
        middle = len(mine) // 2 if leads_to[j, 0] != NOTHING and leads_to[j, 1] != NOTHING else -1
        for side in range(2):
            half = mine
            if middle >= 0:
                half = mine[:middle] if side == 0 else mine[middle:]
            if leads_to[j, side] != NOTHING and len(half) >= 3:
                sides[j, side] = fit_line(points, half, sigma_range, sigma_bearing)
    return sides


@numba.njit(cache=True, error_model="numpy")
def find_landmarks(
    points: Array,
    ranges: Array,
    bearings: Array,
    pieces: Indices,
    piece_of_line: Indices,
    lines: Array,
    where: Indices,
    owner: Indices,
    closed: bool,
    cyclic: bool,
    use_corners: bool,
    use_ends: bool,
    max_gap: float,
    min_angle: float,
    max_range: float,
    margin: float,
    min_points: int,
    threshold: float,
    sigma_range: float,
    sigma_bearing: float,
) -> tuple[Indices, Array]:
    """Landmarks of one scan, all in the laser's frame, metres and radians.

    Takes the stages' results in the scan's rolled order. Returns (K,) kinds and (K, 5) x, y, xx, xy, yy.
    """
    count, spacing = len(lines), mean_spacing(bearings)
    leads_to = np.full((count, 2), NOTHING, np.int64)  # from each line's first and last return
    if use_corners:
        mark_corners(points, piece_of_line, lines, where, cyclic, max_gap, min_angle, leads_to)
    if use_ends and not cyclic:
        mark_ends(
            ranges, bearings, pieces, piece_of_line, lines, where, closed, max_range, margin, min_points, threshold,
            leads_to,
        )  # fmt: skip
    sides = _fit_sides(points, lines, owner, leads_to, sigma_range, sigma_bearing)
    kinds = np.empty(2 * count, np.int64)
    found = np.empty((2 * count, 5))
    k = 0
    for j in range(count):
        if leads_to[j, 1] >= 0:
            kinds[k], found[k] = CORNER, intersect(sides[j, 1], sides[leads_to[j, 1], 0])
            k += 1
        for side, step in ((0, -spacing), (1, spacing)):
            if leads_to[j, side] == LOOSE:
                bearing = bearings[where[j, 1 + side]]
                kinds[k], found[k] = END, loose_end(sides[j, side], bearing, step, sigma_bearing)
                k += 1
    return kinds[:k].copy(), found[:k].copy()
