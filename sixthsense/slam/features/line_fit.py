"""Fitting one line, with its covariance, and whether it is one: returns that two lines explain better are cut.

A line is (alpha, d), the points with x cos(alpha) + y sin(alpha) = d and d >= 0, in the laser's frame. The test is the
likelihood ratio of two lines against one, maximised over the place of the cut (Quandt, "The estimation of the
parameters of a linear regression system obeying two separate regimes", JASA 53, 1958). It shows a bend, a step and a
foreign return at an end long before any return is several sigmas off the line.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numba
import numpy as np

from sixthsense.core.geometry import Array
from sixthsense.slam.features.partition import Indices

_MIN_INCIDENCE_COSINE = 0.02  # a wall met flatter than 1.1 degrees is weighted as if met at that angle


class LaserSigmas(NamedTuple):
    """Assumed noise of the laser."""

    range_m: float
    """sigma of a range"""
    bearing_rad: float
    """sigma of a beam's direction"""


@numba.njit(cache=True, error_model="numpy")
def across_line(x: float, y: float, line: Array, sigmas: LaserSigmas) -> tuple[float, float, float]:
    """Distance of a return from a line, its derivative by alpha, and the variance of the distance by the laser's noise.

    The derivative by d is -1. The lever arm is that of the line, since that of a noisy return would bias the angle.
    """
    c, s = math.cos(line[0]), math.sin(line[0])
    r = math.hypot(x, y)
    cosine = max((x * c + y * s) / r, _MIN_INCIDENCE_COSINE)  # of the angle between beam and normal
    arm = min(line[1] / cosine, 2.0 * r) * ((y * c - x * s) / r)
    var = (sigmas.range_m * cosine) ** 2 + (sigmas.bearing_rad * arm) ** 2
    return x * c + y * s - line[1], arm, max(var, 1e-18)


@numba.njit(cache=True, error_model="numpy")
def fit_line(points: Array, index: Indices, sigmas: LaserSigmas) -> Array:
    """Fit a line to laser returns, with its covariance.

    `points` (N, 2) metres in the laser's frame, of which those at `index` take part.
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
        i_aa = i_ad = i_dd = b_a = b_d = 0.0
        line = np.array([alpha, d])
        for i in index:
            e, arm, var = across_line(points[i, 0], points[i, 1], line, sigmas)
            weight = 1.0 / var
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
def parallel_line(points: Array, index: Indices, line: Array, sigmas: LaserSigmas) -> Array:
    """The line through the returns at `index` that is parallel to a fitted `line`; arguments and result as `fit_line`.

    Its distance is the weighted mean of the returns' distances; direction and its variance are those of `line`.
    """
    total = offset = along = 0.0
    for i in index:
        off, arm, var = across_line(points[i, 0], points[i, 1], line, sigmas)
        total += 1.0 / var
        offset += (off + line[1]) / var
        along += arm / var
    arm = along / total
    aa = line[2]
    return np.array([line[0], offset / total, aa, arm * aa, arm * arm * aa + 1.0 / total])


_LEAST_VAR_M2 = 1e-8  # no wall is straight to less than 0.1 mm, however well a laser is assumed to measure


@numba.njit(cache=True, error_model="numpy")
def cut_threshold(returns: int, false_alarm: float) -> float:
    """The gain in chi-square of the best cut that a straight wall exceeds with the probability `false_alarm`.

    At a given place the gain has two degrees of freedom, so that its tail is exp(-gain / 2). The best of n places is
    as large as that of n / (2 + n / 100) independent ones, by simulation.
    """
    places = returns / (2.0 + returns / 100.0)
    threshold: float = 2.0 * math.log(places / false_alarm)
    return threshold


@numba.njit(cache=True, error_model="numpy")
def _explained(sums: Array, a: int, b: int) -> float:
    """Decrease of chi-square by the line fitted to the returns from a to before b, from rows of cumulative `sums`."""
    w, arm, arm_sq = sums[b, 0] - sums[a, 0], sums[b, 1] - sums[a, 1], sums[b, 2] - sums[a, 2]
    off, turn = sums[b, 3] - sums[a, 3], sums[b, 4] - sums[a, 4]
    spread = arm_sq - arm * arm / w
    explained: float = off * off / w
    # One or two returns, or several in one place, determine an offset alone: two would fit any line.
    if b - a > 2 and spread > 1e-9 * arm_sq:
        explained += (turn - arm * off / w) ** 2 / spread
    return explained


@numba.njit(cache=True, error_model="numpy")
def cut_gains(points: Array, index: Indices, line: Array, sigmas: LaserSigmas) -> Array:
    """(n - 1,) decrease of chi-square if the returns at `index` (n,) are two lines, cut before the second to last one.

    `points` (N, 2) metres in the laser's frame; `line` (5,) is fitted to them, and both lines are near it.
    """
    n = len(index)
    sums = np.zeros((n + 1, 5))
    for k in range(n):
        off, arm, var = across_line(points[index[k], 0], points[index[k], 1], line, sigmas)
        weight = 1.0 / max(var, _LEAST_VAR_M2)
        sums[k + 1, 0] = sums[k, 0] + weight
        sums[k + 1, 1] = sums[k, 1] + weight * arm
        sums[k + 1, 2] = sums[k, 2] + weight * arm * arm
        sums[k + 1, 3] = sums[k, 3] + weight * off
        sums[k + 1, 4] = sums[k, 4] + weight * arm * off
    gains = np.empty(n - 1)
    one = _explained(sums, 0, n)
    for k in range(1, n):
        gains[k - 1] = _explained(sums, 0, k) + _explained(sums, k, n) - one
    return gains


@numba.njit(cache=True, error_model="numpy")
def straight_pieces(
    points: Array, index: Indices, line: Array, sigmas: LaserSigmas, false_alarm: float, least: int
) -> Indices:
    """(P, 2) first and past-last place in `index` (n,) of the straight pieces of its returns, in order.

    `line` (5,) is fitted to all of them. A piece is cut where two lines explain it best, if they explain it better than
    a straight wall allows with the probability `false_alarm`. Pieces with fewer than `least` returns are left out,
    unless they are more than half of all: then a short wall has lost a few foreign ones.
    """
    found = np.empty((len(index), 2), np.int64)
    count = 0
    stack = [(0, len(index))]
    while len(stack) > 0:
        a, b = stack.pop()
        few = b - a < least and 2 * (b - a) <= len(index)
        if few or b - a < max(2, min(least, 3)):
            continue
        piece = index[a:b]
        if b - a < len(index):
            line = fit_line(points, piece, sigmas)
        gains = cut_gains(points, piece, line, sigmas)
        best = int(np.argmax(gains))
        if gains[best] > cut_threshold(b - a, false_alarm):
            stack.append((a + best + 1, b))
            stack.append((a, a + best + 1))
        else:
            found[count, 0], found[count, 1] = a, b
            count += 1
    return found[:count].copy()
