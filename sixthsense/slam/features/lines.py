"""Line fitting: RANSAC (Fischler and Bolles 1981), then orthogonal least squares with the line's covariance.

A line is (alpha, d), the points with x cos(alpha) + y sin(alpha) = d and d >= 0, in the laser's frame.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from sixthsense.core.geometry import Array
from sixthsense.slam.features.partition import Indices

_MIN_INCIDENCE_COSINE = 0.02  # a wall met flatter than 1.1 degrees is weighted as if met at that angle


class LaserSigmas(NamedTuple):
    """Assumed noise of the laser."""

    range_m: float
    """sigma of a range"""
    bearing_rad: float
    """sigma of a beam's direction"""


class LineRules(NamedTuple):
    """When returns make a line, and how it is fitted."""

    ransac: bool
    """off: a span is fitted as one line"""
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
        p, q = points[index[a]], points[index[b]]
        length = math.hypot(q[0] - p[0], q[1] - p[1])
        if length < 1e-9:
            continue
        nx, ny = (q[1] - p[1]) / length, -(q[0] - p[0]) / length
        d = nx * p[0] + ny * p[1]
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
def fit_line(points: Array, index: Indices, sigma_range: float, sigma_bearing: float) -> Array:
    """Fit a line to laser returns, with its covariance.

    `points` (N, 2) metres in the laser's frame, of which those at `index` take part; sigmas in metres and radians.
    Returns (5,): alpha, d and the entries aa, ad, dd of its covariance. Orthogonal least squares (Arras and Siegwart
    1997) gives the initial line. Two Gauss-Newton steps then weight each return by its noise across the line, with
    lever arms of the fitted line, since those of the noisy returns would bias the angle.
    """
    n = len(index)
    mx = my = sxx = syy = sxy = 0.0
    for i in index:
        mx += points[i, 0] / n
        my += points[i, 1] / n
    for i in index:
        dx, dy = points[i, 0] - mx, points[i, 1] - my
        sxx += dx * dx
        syy += dy * dy
        sxy += dx * dy
    alpha = 0.5 * math.atan2(-2.0 * sxy, syy - sxx)
    d = mx * math.cos(alpha) + my * math.sin(alpha)
    if d < 0.0:
        alpha, d = alpha + math.pi, -d
    aa = ad = dd = 0.0
    for _ in range(2):
        c, s = math.cos(alpha), math.sin(alpha)
        i_aa = i_ad = i_dd = b_a = b_d = 0.0
        for i in index:
            x, y = points[i, 0], points[i, 1]
            r = math.hypot(x, y)
            cosine = max((x * c + y * s) / r, _MIN_INCIDENCE_COSINE)  # of the angle between beam and normal
            sine = (y * c - x * s) / r
            arm = min(d / cosine, 2.0 * r) * sine
            across_sq = (sigma_range * cosine) ** 2 + (sigma_bearing * arm) ** 2
            weight = 1.0 / max(across_sq, 1e-18)
            e = x * c + y * s - d
            # de/dalpha = arm, de/dd = -1
            i_aa += weight * arm * arm
            i_ad -= weight * arm
            i_dd += weight
            b_a -= weight * arm * e
            b_d += weight * e
        det = i_aa * i_dd - i_ad * i_ad
        aa, ad, dd = i_dd / det, -i_ad / det, i_aa / det
        alpha += aa * b_a + ad * b_d
        d += ad * b_a + dd * b_d
    if d < 0.0:
        alpha, d, ad = alpha + math.pi, -d, -ad
    return np.array([alpha, d, aa, ad, dd])


@numba.njit(cache=True, error_model="numpy")
def parallel_line(points: Array, index: Indices, line: Array, sigma_range: float, sigma_bearing: float) -> Array:
    """The line through the returns at `index` that is parallel to a fitted `line`; arguments and result as `fit_line`.

    Its distance is the weighted mean of the returns' distances; direction and its variance are those of `line`.
    """
    c, s = math.cos(line[0]), math.sin(line[0])
    total = offset = along = 0.0
    for i in index:
        x, y = points[i, 0], points[i, 1]
        r = math.hypot(x, y)
        cosine = max((x * c + y * s) / r, _MIN_INCIDENCE_COSINE)
        arm = min(line[1] / cosine, 2.0 * r) * (y * c - x * s) / r
        weight = 1.0 / max((sigma_range * cosine) ** 2 + (sigma_bearing * arm) ** 2, 1e-18)
        total += weight
        offset += weight * (x * c + y * s)
        along += weight * arm
    arm = along / total
    aa = line[2]
    return np.array([line[0], offset / total, aa, arm * aa, arm * arm * aa + 1.0 / total])


@numba.njit(cache=True, error_model="numpy")
def _one_line(
    points: Array, free: NDArray[np.bool_], rules: LineRules, sigmas: LaserSigmas, seed: int
) -> tuple[Array, Indices]:
    """One line through the free points, as `fit_line` returns it, and the points it was fitted to."""
    if not rules.ransac:
        index = np.flatnonzero(free)
        return fit_line(points, index, sigmas.range_m, sigmas.bearing_rad), index
    line = ransac(points, free, rules.threshold_m, rules.iterations, seed)
    c, s = math.cos(line[0]), math.sin(line[0])
    near = np.abs(points[:, 0] * c + points[:, 1] * s - line[1]) <= rules.threshold_m
    index = np.flatnonzero(free & near)
    if len(index) < 2:
        return np.zeros(5), index[:0]
    fit = fit_line(points, index, sigmas.range_m, sigmas.bearing_rad)
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
        free[spans[k, 0] : spans[k, 1]] = True
        while np.sum(free) >= rules.min_points:
            seed = 1 + (seed * 69621) % 2147483645
            fit, index = _one_line(points, free, rules, sigmas, seed)
            if len(index) < rules.min_points:
                break
            free[index] = False
            a, b = points[index[0]], points[index[-1]]
            along = (b[1] - a[1]) * math.cos(fit[0]) - (b[0] - a[0]) * math.sin(fit[0])
            if abs(along) >= rules.min_length_m:
                owner[index] = found
                lines[found] = fit
                where[found] = (k, index[0], index[-1])
                found += 1
    order = np.argsort(where[:found, 1])
    rank = np.empty(found + 1, np.int64)
    rank[order] = np.arange(found)
    rank[found] = -1
    for i in range(n):
        owner[i] = rank[owner[i]]
    return lines[order], where[order], owner
