"""How dense points of no known landmark are where the robot is: what the match of a point is weighed against.

A point that is observed where a known one is predicted may be another one, that nobody has seen before. How likely that
is depends on how large the uncertainty of the prediction is, and on how dense unknown points are. Both are compared as
densities of the observation: D. Reid, "An algorithm for tracking multiple targets", IEEE Trans. Automatic Control
24(6), 1979, eq. 16.
"""

from __future__ import annotations

import math

import numpy as np

from sixthsense.core.geometry import Array
from sixthsense.slam.association.observed import Mask

_MEMORY = 100.0
"""keyframes over which the density is averaged: a new room shows more unknown points than a known one"""


def least_densities(density: float, walls: Mask, odds: float) -> Array:
    """(k,) least logarithm of the density of a match with each landmark, for it to be `odds` times likelier.

    It is minus infinity for `walls` (k,), which are not weighed. `density` is that of unknown points, 1/m^2.
    """
    dense = np.where(walls, 0.0, odds * density)
    return np.log(dense, out=np.full(len(walls), -np.inf), where=dense > 0.0)


class UnknownPoints:
    """Counts the points that keyframes show and that are matched with no known landmark."""

    def __init__(self) -> None:
        self._unmatched = 0.0
        self._points = 0.0
        self._squares_m2 = 0.0
        """sum of the squared distances of all points from the robot"""

    def add(self, points: Array, is_unmatched: Mask) -> None:
        """Record the points (k, 2) of a keyframe, robot's frame, and which of them have no match."""
        keep = 1.0 - 1.0 / _MEMORY
        self._unmatched = keep * self._unmatched + np.count_nonzero(is_unmatched)
        self._points = keep * self._points + len(points)
        self._squares_m2 = keep * self._squares_m2 + float(np.sum(points**2))

    def density(self, points: Array) -> float:
        """Unknown points per m^2 that a keyframe with `points` (k, 2) is expected to show.

        Points lie anywhere in a disc, whose size is that of all points of the last keyframes. One more unknown point is
        expected than was seen (Laplace).
        """
        square_m2 = self._squares_m2 + float(np.sum(points**2))
        if square_m2 == 0.0:
            return 0.0
        area_m2 = 2.0 * math.pi * square_m2 / (self._points + len(points))  # its radius squared is twice the mean
        return (self._unmatched + 1.0) / _MEMORY / area_m2
