"""Finding the lines of a scan: least squares over each piece, and a test whether it is straight."""

from __future__ import annotations

import math
from typing import NamedTuple

import numba
import numpy as np

from sixthsense.core.geometry import Array
from sixthsense.slam.features.line_fit import LaserSigmas, fit_line, straight_pieces
from sixthsense.slam.features.partition import Indices

_WHOLE = np.zeros((1, 2), np.int64)  # one piece, of all returns
_REFITS = 3
"""without the returns that are too far from the line before"""


class LineRules(NamedTuple):
    """When returns make a line, and how it is fitted."""

    threshold_m: float
    """greatest distance of an inlier from its line"""
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
def _fit_span(points: Array, first: int, past: int, rules: LineRules, sigmas: LaserSigmas) -> tuple[Array, Indices]:
    """The line through the returns from `first` to before `past`, as `fit_line` returns it, and its inliers.

    Returns farther from the line than the threshold are left out, and the others fitted again.
    """
    span = np.arange(first, past)
    index = span
    fit = fit_line(points, index, sigmas)
    for _ in range(_REFITS):
        off = points[span, 0] * math.cos(fit[0]) + points[span, 1] * math.sin(fit[0]) - fit[1]
        inliers = span[np.abs(off) <= rules.threshold_m]
        if len(inliers) < rules.min_points:
            return fit, inliers
        if len(inliers) == len(index) and np.all(inliers == index):
            break
        index = inliers
        fit = fit_line(points, index, sigmas)
    return fit, index


@numba.njit(cache=True, error_model="numpy")
def fit_lines(points: Array, spans: Indices, rules: LineRules, sigmas: LaserSigmas) -> tuple[Array, Indices, Indices]:
    """Fit a line to each span of the scan, and cut it where it is not straight (report section 4.2).

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
        if spans[k, 1] - spans[k, 0] < rules.min_points:
            continue
        fit, index = _fit_span(points, spans[k, 0], spans[k, 1], rules, sigmas)
        if len(index) < rules.min_points:
            continue
        pieces = _WHOLE
        if rules.cut_false_alarm > 0.0:
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
    return lines[:found], where[:found], owner
