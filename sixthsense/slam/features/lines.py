"""Finding the lines of a scan: RANSAC (Fischler and Bolles 1981), a test whether they are straight, least squares."""

from __future__ import annotations

import math
from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from sixthsense.core.geometry import Array
from sixthsense.core.ordering import ascending
from sixthsense.slam.features.line_fit import LaserSigmas, fit_line, straight_pieces
from sixthsense.slam.features.partition import Indices

_WHOLE = np.zeros((1, 2), np.int64)  # one piece, of all returns


class LineRules(NamedTuple):
    """When returns make a line, and how it is fitted."""

    threshold_m: float
    """greatest distance of an inlier from its line"""
    iterations: int
    """pairs drawn at most"""
    least_squares: bool
    """off: the line through RANSAC's best pair"""
    min_points: int
    """fewest inliers"""
    min_length_m: float
    """a shorter line is dropped"""
    cut_false_alarm: float
    """probability that a straight wall is cut in two; 0: lines are not cut"""


class FittedLines(NamedTuple):
    """All lines of one scan, in the order of their first return."""

    fits: Array
    """(L, 5) alpha, d and the entries aa, ad, dd of its covariance"""
    ends: Indices
    """(L, 2) first and last inlier"""
    piece: Indices
    """(L,) first-level partition that the line lies in"""
    owner: Indices
    """(N,) line that owns each return, -1 for none"""


@numba.njit(cache=True, error_model="numpy")
def _next_random(state: int) -> tuple[int, int]:
    """One step of a 31-bit multiplicative congruential generator (Park and Miller 1988)."""
    state = (48271 * state) % 2147483647
    return state, state


@numba.njit(cache=True, error_model="numpy")
def ransac(points: Array, free: NDArray[np.bool_], threshold: float, iterations: int, seed: int) -> Array:
    """The line through two free points with the most free points within `threshold` (RANSAC).

    `points` (N, 2) metres, `free` (N,) marks the points taking part, `seed` in [1, 2^31 - 1). Returns (3,): alpha, d
    and the number of inliers; stops early once every free point is one.
    """
    index = np.flatnonzero(free)
    n = len(index)
    best = np.zeros(3)
    if n < 2:
        return best
    state = seed
    for _ in range(iterations):
        state, u = _next_random(state)
        state, w = _next_random(state)
        a, b = u % n, w % (n - 1)
        if b >= a:
            b += 1
        x, y = points[index[a], 0], points[index[a], 1]
        dx, dy = points[index[b], 0] - x, points[index[b], 1] - y
        length = math.hypot(dx, dy)
        if length == 0.0:
            continue
        nx, ny = dy / length, -dx / length
        d = nx * x + ny * y
        inliers = 0
        for i in index:
            if abs(nx * points[i, 0] + ny * points[i, 1] - d) <= threshold:
                inliers += 1
        if inliers > best[2]:
            best[0], best[1], best[2] = math.atan2(ny, nx), d, inliers
            if inliers == n:
                break
    if best[1] < 0.0:
        best[0] += math.pi
        best[1] = -best[1]
    return best


@numba.njit(cache=True, error_model="numpy")
def _one_line(
    points: Array, free: NDArray[np.bool_], rules: LineRules, sigmas: LaserSigmas, seed: int
) -> tuple[Array, Indices]:
    """One line through the free points, as `fit_line` returns it, and the points it was fitted to."""
    line = ransac(points, free, rules.threshold_m, rules.iterations, seed)
    c, s = math.cos(line[0]), math.sin(line[0])
    near = np.abs(points[:, 0] * c + points[:, 1] * s - line[1]) <= rules.threshold_m
    index = np.flatnonzero(free & near)
    if len(index) < 2:
        return np.zeros(5), index[:0]
    fit = fit_line(points, index, sigmas)
    if not rules.least_squares:
        fit[0], fit[1] = line[0], line[1]
    return fit, index


@numba.njit(cache=True, error_model="numpy")
def fit_lines(
    points: Array, spans: Indices, rules: LineRules, sigmas: LaserSigmas, seed: int
) -> tuple[Array, Indices, Indices]:
    """Fit lines to each span of the scan, one after the other until too few points are left (report section 4.2).

    `points` (N, 2) metres in the laser's frame; `spans` (S, 2) first and past-last index. Returns the lines
    (L, 5) as `fit_line` does, in the order of their first return; (L, 3) span, first and last inlier of each; and (N,)
    the line that owns each return, -1 for none.
    """
    n = points.shape[0]
    lines = np.empty((n, 5))
    where = np.empty((n, 3), np.int64)
    owner = np.full(n, -1, np.int64)
    found = 0
    for k in range(spans.shape[0]):
        free = np.zeros(n, np.bool_)
        for i in range(spans[k, 0], spans[k, 1]):
            free[i] = True
        while np.sum(free) >= rules.min_points:
            seed = 1 + (seed * 69621) % 2147483645
            fit, index = _one_line(points, free, rules, sigmas, seed)
            if len(index) < rules.min_points:
                break
            for i in index:
                free[i] = False
            pieces = _WHOLE
            if rules.cut_false_alarm > 0.0 and rules.least_squares:
                pieces = straight_pieces(points, index, fit, sigmas, rules.cut_false_alarm, rules.min_points)
            for first, past in pieces:
                own = index[first:past] if past > 0 else index
                if len(own) < len(index):
                    fit = fit_line(points, own, sigmas)
                dx, dy = points[own[-1], 0] - points[own[0], 0], points[own[-1], 1] - points[own[0], 1]
                along = dy * math.cos(fit[0]) - dx * math.sin(fit[0])
                if abs(along) >= rules.min_length_m:
                    for i in own:
                        owner[i] = found
                    for i in range(5):
                        lines[found, i] = fit[i]
                    where[found, 0], where[found, 1], where[found, 2] = k, own[0], own[-1]
                    found += 1
    order = ascending(where[:found, 1].copy())
    rank = np.empty(found + 1, np.int64)
    for i in range(found):
        rank[order[i]] = i
    rank[found] = -1
    for i in range(n):
        owner[i] = rank[owner[i]]
    return lines[order], where[order], owner
