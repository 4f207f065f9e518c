"""How dense points of no known landmark are where the robot is: what the match of a point is weighed against.

A point that is observed where a known one is predicted may be another one, that nobody has seen before. How likely that
is depends on how large the uncertainty of the prediction is, and on how dense unknown points are. Both are compared as
densities of the observation: D. Reid, "An algorithm for tracking multiple targets", IEEE Trans. Automatic Control
24(6), 1979, eq. 16.

Unknown points are denser beside a known one that is seen from a new side: the ends of both faces of a wall lie as far
apart as it is thick. The share of such points is counted where the place of the known one is certain enough to tell.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from sixthsense.core.geometry import Array
from sixthsense.slam.association.corners import MEMORY
from sixthsense.slam.association.observed import Mask

_MEMORY = 100.0
"""keyframes over which the density is averaged: a new room shows more unknown points than a known one"""


class UnknownDensity(NamedTuple):
    """How many unknown points per m^2 a keyframe is expected to show."""

    anywhere: float
    beside: float
    """a known one that was seen, but not from this side"""

    def least(self, walls: Mask, is_new_side: Mask, odds: float) -> Array:
        """(k,) least logarithm of the density of a match with each landmark, for it to be `odds` times likelier.

        It is minus infinity for `walls` (k,), which are not weighed. `is_new_side` (k,) marks the points that are seen
        from a new side.
        """
        dense = odds * (self.anywhere + np.where(is_new_side, self.beside, 0.0))
        return np.log(dense, out=np.full(len(walls), -math.inf), where=~walls & (dense > 0.0))


class UnknownPoints:
    """Counts the points that keyframes show and that are matched with no known landmark."""

    def __init__(self, separation_m: float) -> None:
        """With `separation_m`, within which a point is beside another one; 0: none is."""
        self._unmatched = 0.0
        self._points = 0.0
        self._squares_m2 = 0.0
        """sum of the squared distances of all points from the robot"""
        self._beside_m2 = math.pi * separation_m**2
        self._from_new_side = 0.0
        """known points at whose place something was seen from a new side"""
        self._others = 0.0
        """those of them where it was another point"""

    def add(self, points: Array, is_unmatched: Mask) -> None:
        """Take the points (k, 2) of a keyframe, robot's frame, and which of them have no match."""
        keep = 1.0 - 1.0 / _MEMORY
        self._unmatched = keep * self._unmatched + np.count_nonzero(is_unmatched)
        self._points = keep * self._points + len(points)
        self._squares_m2 = keep * self._squares_m2 + float(np.sum(points**2))

    def add_new_side(self, log_density: float) -> float:
        """The probability that what is seen from a new side beside a known point is this one.

        `log_density` is the logarithm of its density if it is. It counts as another point by the rest.
        """
        share = self.share_of_others
        is_other = share / self._beside_m2
        is_same = (1.0 - share) * math.exp(log_density)
        keep = 1.0 - 1.0 / MEMORY
        self._others = keep * self._others + is_other / (is_other + is_same)
        self._from_new_side = keep * self._from_new_side + 1.0
        return is_same / (is_other + is_same)

    @property
    def share_of_others(self) -> float:
        """Of the points that are seen from a new side beside a known one; a half before any is (Laplace)."""
        return (self._others + 1.0) / (self._from_new_side + 2.0)

    def density(self, points: Array) -> UnknownDensity:
        """That in a keyframe that shows `points` (k, 2).

        Points lie anywhere in a disc, whose size those of earlier keyframes tell, too. One more unknown point is
        expected than was seen: that none was does not say that there is none. Points that are too near a known one to
        be new count, too, since a match is as wrong with these.
        """
        beside = self.share_of_others / self._beside_m2 if self._beside_m2 > 0.0 else 0.0
        square_m2 = self._squares_m2 + float(np.sum(points**2))
        if square_m2 == 0.0:
            return UnknownDensity(0.0, beside)
        area_m2 = 2.0 * math.pi * square_m2 / (self._points + len(points))  # its radius squared is twice the mean
        return UnknownDensity((self._unmatched + 1.0) / _MEMORY / area_m2, beside)
