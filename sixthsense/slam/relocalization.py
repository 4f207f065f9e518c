"""Where in a map a robot is that does not know where it began.

The robot drives with a map of its own, and looks for its place as for a loop closure: what it has seen lately is
searched for in the whole map, one place must explain clearly more than all others, scans must align with the map there,
and another vote some metres later must agree.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from sixthsense.config import Config
from sixthsense.core.geometry import Array, Pose
from sixthsense.core.laser import Scan
from sixthsense.slam.mapping.submap import Submap
from sixthsense.slam.scans.evidence import followed_back
from sixthsense.slam.scans.map_views import MapViews
from sixthsense.slam.scans.place_search import (
    LEAST_POINTS,
    Hypothesis,
    Look,
    best_place,
    is_same_place,
    recent_points,
)
from sixthsense.slam.scans.places import Window, pyramid
from sixthsense.slam.scans.verification import vote_for
from sixthsense.slam.scans.votes import Vote, Votes

_SPACING_M, _M_PER_RAD = 0.4, 0.4  # between two scans that are kept, and what a turn counts

FOUND_SIGMA = (0.1, 0.1, 0.05)
"""of a start that was found, m and rad; the first scan makes it precise"""
MOST_DRIVEN_M = 40.0
"""without a place, the robot is taken to be elsewhere"""


class Relocalizer:
    """Looks for the place of a robot in a map, from poses in a frame of its own."""

    def __init__(self, evidence: Submap, config: Config, expected: Sequence[Pose] = ()) -> None:
        """Search in a map of this evidence, with the cells, the obstacles and the least score that `config` says.

        A place that agrees with one of `expected`, each a `T_map_own`, needs no second find.
        """
        self._evidence, self._config, self._expected = evidence, config, tuple(expected)
        self._search: _Search | None = None
        """from the first scan on"""
        self._last: Pose | None = None
        self.driven_m = 0.0
        """of the scans so far"""
        self.place: Pose | None = None
        """`T_map_own` by what was seen so far, if that fits one place alone; not yet confirmed by a second find"""

    def take(self, scan: Scan, pose: Pose) -> Pose | None:
        """Take a scan at `pose` in the robot's own frame; `T_map_own` once it is certain, None before."""
        moved = Pose() if self._last is None else self._last.inverse() @ pose
        distance_m = math.hypot(moved.x, moved.y)
        if self._last is not None and distance_m + _M_PER_RAD * abs(moved.theta) < _SPACING_M:
            return None
        self._last, self.driven_m = pose, self.driven_m + distance_m
        if self._search is None:
            self._search = _Search(MapViews(self._evidence, self._config.grid, scan), self._config.scans.min_score)
        laser = pose @ scan.T_robot_laser
        found = self._search.look(scan, laser, self.driven_m)
        if found is None:
            return None
        self.place = Pose.from_array(found.pose) @ laser.inverse()
        if any(is_same_place(found.pose, (T_map_own @ laser).array()) for T_map_own in self._expected):
            return self.place
        vote = self._search.vote(found)
        if vote is None or not self._search.votes.agreeing(vote):
            return None
        return Pose.from_array(vote.pose) @ laser.inverse()


class _Search:
    """Looks for scans in a map."""

    def __init__(self, views: MapViews, min_score: float) -> None:
        self._min_score = min_score
        self._views = views
        self.votes = Votes(views)
        self._travelled = np.zeros(0)
        """(K,) m, at each of the robot's scans; minus infinity at the views of the map"""
        obstacles = views.obstacles
        self._where = (pyramid(obstacles), _everywhere(obstacles)) if len(obstacles) else None
        """cells to search in, and the window; None in a map without obstacles"""

    def look(self, scan: Scan, laser: Pose, travelled_m: float) -> Hypothesis | None:
        """Keep a scan of the robot, and look for the place of the last ones; one that nothing else looks like."""
        key = self._views.add(scan, laser)
        known = np.full(key + 1 - len(self._travelled), -np.inf)
        self._travelled = np.concatenate([self._travelled, known])
        self._travelled[key] = travelled_m
        points = recent_points(self._views, key, self._travelled)
        if self._where is None or len(points) < LEAST_POINTS:
            return None
        look = Look(*self._where, np.zeros(3), self._views)
        back = followed_back(self._travelled, key)
        found = best_place(self._views, back, points, [look], self._min_score)
        return None if found is None or found.is_ambiguous else found

    def vote(self, found: Hypothesis) -> Vote | None:
        """A vote for a place of the newest scan, if the last ones agree about it."""
        return vote_for(self._views, len(self._travelled) - 1, self._travelled, found)


def _everywhere(obstacles: Array) -> Window:
    """The whole map."""
    low, high = obstacles.min(axis=0), obstacles.max(axis=0)
    return Window(np.array([*(0.5 * (low + high)), 0.0]), 0.5 * float((high - low).max()), math.pi)
