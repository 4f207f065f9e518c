"""Where in a map a robot is that does not know where it began: told once what it has seen fits one place alone.

The robot drives with a map of its own. The scans of its last metres together are searched for in the whole map.
A place counts when the map explains most of what it can judge there, and no other place nearly as much. Two such finds,
some metres apart, must agree.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from sixthsense.config import GridConfig
from sixthsense.core.geometry import Array, Pose, wrap_angle
from sixthsense.core.laser import Scan
from sixthsense.slam.map_fit import Obstacles, fitted, judged
from sixthsense.slam.mapping.submap import Submap
from sixthsense.slam.scans.branch_and_bound import Apart, Window, peaks
from sixthsense.slam.scans.submap import Pyramid, pyramid

_STRETCH_M = 8.0  # of driving whose scans are searched for
_SPACING_M, _M_PER_RAD = 0.4, 0.4  # between two of these scans, and what a turn counts
_POINTS_PER_SCAN, _MOST_POINTS = 60, 400
_LEAST_POINTS = 40
_LEAST_SCORE, _AS_GOOD_SCORE = 0.35, 0.75  # of a place, and as a part of the best one's
_LEAST_SHARE = 0.8  # explained of what is judged
_CLEARLY, _TIMES = 0.04, 2.0  # elsewhere so many times as much is left unexplained, and so much more
_LEAST_JUDGED = 0.6  # of the returns
_APART, _SAME = Apart(0.5, 0.2), Apart(0.4, 0.1)
_VOTES_APART_M = 2.0

FOUND_SIGMA = (0.1, 0.1, 0.05)
"""of a start that was found, m and rad; the first scan makes it precise"""
MOST_DRIVEN_M = 40.0
"""without a place, the robot is taken to be elsewhere"""


class _View(NamedTuple):
    """What a scan saw, in the robot's own frame."""

    driven_m: float
    laser: Array
    """(2,)"""
    ends: Array
    """(N, 2) of its beams that returned"""


class _Vote(NamedTuple):
    """A place that nothing else looks like."""

    driven_m: float
    T_map_own: Pose


class Relocalizer:
    """Looks for the place of a robot in a map, from poses in a frame of its own."""

    def __init__(self, evidence: Submap, config: GridConfig, expected: Sequence[Pose] = ()) -> None:
        """Search in a map of this evidence, with cells and obstacles as `config` says.

        A place that agrees with one of `expected`, each a `T_map_own`, needs no second find.
        """
        self._obstacles = Obstacles.of(evidence, config)
        centres = self._obstacles.centres
        self._pyramid: Pyramid | None = pyramid(centres) if len(centres) else None
        low, high = (centres.min(axis=0), centres.max(axis=0)) if len(centres) else (np.zeros(2), np.zeros(2))
        self._centre, self._half_m = 0.5 * (low + high), 0.5 * float((high - low).max())
        self._views: deque[_View] = deque()
        self._last: Pose | None = None
        self._vote: _Vote | None = None
        self._expected = tuple(expected)
        self.driven_m = 0.0
        """of the scans so far"""

    def take(self, scan: Scan, pose: Pose) -> Pose | None:
        """Take a scan at `pose` in the robot's own frame; `T_map_own` once it is certain, None before."""
        if self._last is not None:
            moved = self._last.inverse() @ pose
            distance_m = math.hypot(moved.x, moved.y)
            if distance_m + _M_PER_RAD * abs(moved.theta) < _SPACING_M:
                return None
            self.driven_m += distance_m
        self._last = pose
        self._keep(scan, pose)
        found = self._only_place(pose)
        if found is None:
            return None
        if any(_are_near(T_map_own @ pose, found @ pose, _SAME) for T_map_own in self._expected):
            return found
        vote = self._vote
        if vote is None or not _are_near(vote.T_map_own @ pose, found @ pose, _SAME):
            self._vote = _Vote(self.driven_m, found)
            return None
        return found if self.driven_m >= vote.driven_m + _VOTES_APART_M else None

    @property
    def place(self) -> Pose | None:
        """`T_map_own` by what was seen so far, if that fits one place alone; not yet confirmed by a second find."""
        return None if self._vote is None else self._vote.T_map_own

    def _keep(self, scan: Scan, pose: Pose) -> None:
        points = scan.points_robot[(scan.ranges > 0.0) & (scan.ranges < scan.max_range)]
        few = points[np.linspace(0, len(points) - 1, min(len(points), _POINTS_PER_SCAN)).astype(np.int64)]
        self._views.append(_View(self.driven_m, pose @ scan.T_robot_laser.position, pose @ few))
        while self._views[0].driven_m < self.driven_m - _STRETCH_M:
            self._views.popleft()

    def _only_place(self, pose: Pose) -> Pose | None:
        """`T_map_own` of the one place that the scans of the stretch fit, if there is one; `pose` is the newest."""
        own = np.concatenate([view.ends for view in self._views])
        if self._pyramid is None or len(own) < _LEAST_POINTS:
            return None
        few = own[np.linspace(0, len(own) - 1, min(len(own), _MOST_POINTS)).astype(np.int64)]
        points = pose.inverse() @ few
        window = Window(np.array([*self._centre, 0.0]), self._half_m, math.pi)
        found = peaks(self._pyramid, points, window, _LEAST_SCORE, _APART)
        places: list[tuple[float, Pose]] = []
        for _, *at in found[found[:, 0] >= _AS_GOOD_SCORE * found[:, 0].max(initial=0.0)].tolist():
            there = Pose(*at)
            place = fitted(points, there, self._obstacles, there, 1e-3 * np.eye(3))
            if not any(_are_near(place, other, _SAME) for _, other in places):
                places.append((self._share(place @ pose.inverse()), place))
        places.sort(key=lambda item: -item[0])
        if not places or places[0][0] < _LEAST_SHARE:
            return None
        if len(places) > 1 and 1.0 - places[1][0] < _TIMES * (1.0 - places[0][0]) + _CLEARLY:
            return None
        return places[0][1] @ pose.inverse()

    def _share(self, T_map_own: Pose) -> float:
        """Share of the returns that the map explains at a place, of those that it judges; 0 if it judges too few."""
        counts = np.array([judged(T_map_own @ v.ends, T_map_own @ v.laser, self._obstacles) for v in self._views])
        explained, contradicted = counts.sum(axis=0).tolist()
        judges = explained + contradicted >= _LEAST_JUDGED * sum(len(view.ends) for view in self._views)
        return float(explained) / (explained + contradicted) if judges else 0.0


def _are_near(one: Pose, other: Pose, apart: Apart) -> bool:
    return math.hypot(one.x - other.x, one.y - other.y) < apart.distance_m and (
        abs(wrap_angle(one.theta - other.theta)) < apart.turn_rad
    )
