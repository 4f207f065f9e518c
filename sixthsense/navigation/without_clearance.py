"""Where the robot fits without the clearance that it keeps, and the gaps that close its way."""

from __future__ import annotations

import math
from collections import Counter

import numpy as np
from scipy import ndimage

from sixthsense.core.geometry import Array, Pose
from sixthsense.navigation.driving_limits import track_cells
from sixthsense.navigation.gridsearch import Distances, cell_before_gap
from sixthsense.navigation.map_window import MapWindow
from sixthsense.slam.mapping.freespace import Bools
from sixthsense.slam.mapping.inflation import stamped

_NEARBY_M = 0.5
"""from the place before a gap: a robot so near to it has looked at the gap"""
_LOOK = 4
"""approaches of a gap that weigh as much as a look at it from nearby"""


def too_near(obstacles: Bools, radius: float) -> Bools:
    """(H, W) the cells whose centre is nearer to an obstacle cell's centre than a radius, in cells."""
    reach = math.floor(radius) + 1
    offsets = np.arange(-reach, reach + 1)
    return stamped(obstacles, np.argwhere(np.hypot(offsets[:, None], offsets[None, :]) < radius) - reach)


def fitting_cells(window: MapWindow, pose: Pose, radius_m: float, least: int) -> Bools:
    """(H, W) the seen cells where the robot fits, of connected parts with at least so many cells or with the robot."""
    fitting = window.seen & ~too_near(window.obstacles, radius_m / window.cell_m)
    labels, _ = ndimage.label(fitting)
    large = np.bincount(labels.ravel()) >= least
    large[labels[window.cell(pose.position)]] = True
    return np.asarray(fitting & large[labels])


def distances_without_clearance(
    window: MapWindow, pose: Pose, radius_m: float, passed: Bools | None = None
) -> Distances:
    """Distances, in cells, from a robot that may come as near to an obstacle cell's centre as its radius.

    It may also drive where it has `passed` (H, W).
    """
    blocked = too_near(window.obstacles, radius_m / window.cell_m)
    if passed is not None:
        blocked &= ~passed
    here = window.cell(pose.position)
    blocked[here] = False
    return Distances(window.seen & ~blocked, blocked, *here)


class GapsOnTheWay:
    """The gaps that close the way to a goal, each to be looked at from nearby a few times."""

    def __init__(self, goal: Array, radius_m: float, tries: int) -> None:
        """On the way to `goal` (2,), of a robot with a radius; each gap is looked at `tries` times.

        An approach that is cut short counts little: the gap has not been seen from nearby.
        """
        self._goal, self._radius_m, self._tries = goal, radius_m, tries
        self._looks: Counter[tuple[int, int]] = Counter()
        """by the square of a metre that holds the place before the gap; an approach counts 1, a look `_LOOK`"""

    def next(self, window: MapWindow, pose: Pose, reachable: Bools, positions: Array) -> Array | None:
        """(2,) the last place that can be reached before a gap on the way; None without one, or if it was tried.

        The gap is one that only the clearance closes, or one that the robot, which has been at `positions` (N, 2), has
        come through. `reachable` is (H, W).
        """
        corner = window.first[1] * window.cell_m, window.first[0] * window.cell_m
        passed = track_cells(positions, corner, window.cell_m, window.seen.shape)
        distances = distances_without_clearance(window, pose, self._radius_m, passed).to_all()
        cell = cell_before_gap(reachable, distances, *window.cell(self._goal))
        if cell is None:
            return None
        place = window.point(*cell)
        square = math.floor(place[0]), math.floor(place[1])
        if math.dist(place, pose.position) <= _NEARBY_M:
            self._looks[square] += _LOOK
        if self._looks[square] >= _LOOK * self._tries:
            return None
        self._looks[square] += 1
        return place
