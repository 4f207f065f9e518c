"""Where in a map a robot is: at its first scan, whose pose is known roughly, or while it drives and does not know.

Both are the search of a loop closure: the map has places as earlier passes have, one of them must explain clearly more
than all others, and a place is that of the scans. A pose that is known roughly is a prior of the first scan's. A robot
that does not know where it is drives with a map of its own; what it has seen lately is searched for, scans must align
with the map there, and another vote some metres later must agree.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from sixthsense.config import Config, GridConfig
from sixthsense.config.errors import InputError
from sixthsense.core.geometry import Array, Pose
from sixthsense.core.laser import Scan
from sixthsense.core.se2 import between, move_covariance
from sixthsense.slam.mapping.submap import Submap
from sixthsense.slam.prior_map import PriorMap
from sixthsense.slam.scans.alignment import Prior, Views
from sixthsense.slam.scans.links import WIDE_GATE_M
from sixthsense.slam.scans.map_views import MapViews
from sixthsense.slam.scans.place_search import (
    Candidate,
    ExpectedPoses,
    PlaceQuery,
    Votes,
    best_place,
    distinct,
    is_same_place,
    judged,
    place_search_of,
    proposed,
    vote_for,
)
from sixthsense.slam.scans.tracking import LEAST_SCORE, aligned
from sixthsense.slam.scans.visibility import Agreement
from sixthsense.slam.scans.visibility import judged as agreement_of

_SPACING_M, _M_PER_RAD = 0.4, 0.4  # between two scans that are kept, and what a turn counts
_KNOWN_M, _KNOWN_RAD = 0.03, 0.02  # sigmas below which linearization at the given pose is good
_LEAST_SHARE = 0.5  # of the returns that the map can judge
_MOST_SQUARE = 21.1  # of a first pose: 0.9999 of chi-square with 3 degrees of freedom

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
        self._search = place_search_of(config)
        self._views: MapViews | None = None
        """from the first scan on"""
        self._votes: Votes | None = None
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
        if self._views is None:
            self._views = MapViews(self._evidence, self._config.grid, scan)
        if self._votes is None:
            self._votes = Votes(self._views)
        views, laser = self._views, pose @ scan.T_robot_laser
        key = views.add(scan, laser, self.driven_m)
        anywhere = ExpectedPoses.anywhere(len(views.anchors))
        query = PlaceQuery(views, key, views.travelled_m, views, anywhere, self._config.scans.min_score)
        found = best_place(query, self._search)
        if found is None or found.is_ambiguous:
            return None
        self.place = Pose.from_array(found.pose) @ laser.inverse()
        if any(is_same_place(found.pose, (T_map_own @ laser).array()) for T_map_own in self._expected):
            return self.place
        vote = vote_for(views, key, views.travelled_m, found)
        if vote is None or not self._votes.agreeing(vote):
            return None
        return Pose.from_array(vote.pose) @ laser.inverse()


def located(scan: Scan, prior: PriorMap, pose: Pose, cov: Array, config: GridConfig) -> Pose:
    """The pose at which the first scan fits the map, near `pose` (`T_world_robot`) of covariance `cov` (3, 3).

    It is the pose itself where that is known well. Otherwise it serves to linearize, since the scan says much more of
    the pose than a `cov` this large. Raises InputError where the scan does not fit the map, and where it fits two
    places.
    """
    if not scan.is_return.any() or not len(prior.evidence.cells):
        return pose
    views, laser = MapViews(prior.evidence, config, scan), pose @ scan.T_robot_laser
    key = views.add(scan, laser, 0.0)
    if max(cov[0, 0], cov[1, 1]) <= _KNOWN_M**2 and cov[2, 2] <= _KNOWN_RAD**2:
        _check_share(_share(views, key, laser.array()), prior)
        return pose
    offset = (laser.position - pose.position).tolist()
    cov_laser = move_covariance((-offset[0], -offset[1], 0.0), cov)
    floor = np.diag([_KNOWN_M, _KNOWN_M, _KNOWN_RAD]) ** 2 * 1e-2
    given = Prior(laser.array(), np.asarray(np.linalg.inv(cov_laser + floor), dtype=np.float64))
    places = _places(views, key, given, cov_laser)
    _check_share(max((_share(views, key, place.pose) for place in places), default=0.0), prior)
    best = judged(views, np.array([key]), places)
    if best.is_ambiguous:
        allowed = "a smaller sigma, or a start from where one scan tells places apart"
        raise InputError("pose_sigma", f"found two places of {prior.name} that the first scan fits", allowed)
    found = aligned(_views(views, key, best.pose), given, best.pose, WIDE_GATE_M)
    return Pose.from_array(found.pose) @ scan.T_robot_laser.inverse()


def _views(views: MapViews, key: int, at: Array) -> Views:
    targets = views.partners(key, at, 1)
    return Views(views.store.returns, key, targets, views.poses[targets])


def _share(views: MapViews, key: int, at: Array) -> float:
    """The share of the returns that the map can judge from a pose (3,) that agree with it."""
    agreement = Agreement(*agreement_of(_views(views, key, at), at))
    return 1.0 - agreement.share if agreement.hits > 0.0 else 0.0


def _check_share(share: float, prior: PriorMap) -> None:
    if share < _LEAST_SHARE:
        found = f"found {prior.name}, of which the first scan shows {100 * share:.0f} %"
        raise InputError("prior_map", found, "a map of this building, and a start at its place there")


def _places(views: MapViews, key: int, given: Prior, cov: Array) -> list[Candidate]:
    """The places that a scan may be from by the map and by the given pose, of covariance `cov` (3, 3).

    Along a wall that hides the place along it the given pose says it: all places there become one.
    """
    count, sigma_m = len(views.anchors), math.sqrt(float(np.linalg.eigvalsh(cov[:2, :2])[-1]))
    sigmas = np.full(count, sigma_m), np.full(count, math.sqrt(cov[2, 2]))
    expected = ExpectedPoses(between(views.anchors, given.pose), *sigmas)
    places = []
    for place in proposed(views, key, views.travelled_m, views, expected, LEAST_SCORE, least_points=1):
        found = aligned(_views(views, key, place.pose), given, place.pose, WIDE_GATE_M)
        if found.slip <= _MOST_SQUARE:
            places.append(place._replace(pose=found.pose))
    return distinct(places)
