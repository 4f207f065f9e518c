"""Fitting one line: orthogonal least squares with the line's covariance.

A line is (alpha, d), the points with x cos(alpha) + y sin(alpha) = d and d >= 0, in the laser's frame.
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
    arm = min(line[1] / cosine, 2.0 * r) * (y * c - x * s) / r
    var = (sigmas.range_m * cosine) ** 2 + (sigmas.bearing_rad * arm) ** 2
    return x * c + y * s - line[1], arm, max(var, 1e-18)


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
    sigmas = LaserSigmas(sigma_range, sigma_bearing)
    total = offset = along = 0.0
    for i in index:
        off, arm, var = across_line(points[i, 0], points[i, 1], line, sigmas)
        total += 1.0 / var
        offset += (off + line[1]) / var
        along += arm / var
    arm = along / total
    aa = line[2]
    return np.array([line[0], offset / total, aa, arm * aa, arm * arm * aa + 1.0 / total])
