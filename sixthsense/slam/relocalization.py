"""Where among the key scans of an earlier run a robot is: at its first scan, or while it drives and does not know.

Both are the search of a loop closure: the earlier run has places as earlier passes have, one of them must fit clearly
better than all others, and a place is that of the scans. A pose that is known roughly is a prior of the first scan's. A
robot that does not know where it is drives with a map of its own; what it has seen lately is searched for, and another
vote some metres later must agree.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from sixthsense.config import Config
from sixthsense.config.errors import InputError
from sixthsense.core.geometry import Array, Pose
from sixthsense.core.laser import Scan
from sixthsense.core.se2 import between, move_covariance
from sixthsense.slam.prior_map import KeyScans, PriorMap
from sixthsense.slam.scans.agreement import agreement_of, contradicted
from sixthsense.slam.scans.alignment import Prior, Views
from sixthsense.slam.scans.graph import overlapping
from sixthsense.slam.scans.known_places import CARRIED_M, KnownPlaces
from sixthsense.slam.scans.links import WIDE_GATE_M
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
)
from sixthsense.slam.scans.returns import ScanStore
from sixthsense.slam.scans.tracking import LEAST_SCORE, aligned

_SPACING_M, _M_PER_RAD = 0.4, 0.4  # between two scans that are kept, and a turn as a distance
_KNOWN_M, _KNOWN_RAD = 0.03, 0.02  # sigmas below which linearization at the given pose is good
_LEAST_SHARE = 0.5  # of the returns that the earlier scans can judge
_MOST_SQUARE = 21.1  # of a first pose: 0.9999 of chi-square with 3 degrees of freedom
_PARTNERS = 3  # earlier scans that the first scan is aligned with

FOUND_SIGMA = (0.1, 0.1, 0.05)
"""of a start that was found, m and rad; the first scan makes it precise"""
MOST_DRIVEN_M = 40.0
"""without a place, the robot is taken to be elsewhere"""


class SoughtScans:
    """Key scans of an earlier run, in its frame, and behind them those of a robot, in a frame of its own."""

    usual_agreement = 1.0
    """nothing is known of what has changed since"""

    def __init__(self, known: KeyScans, config: Config) -> None:
        """Begin with the earlier run."""
        self.store = ScanStore(config.scans.max_range_m)
        self.poses, self.travelled_m = np.zeros((0, 3)), np.zeros(0)
        for scan, pose in zip(known.scans, known.poses, strict=True):
            laser = Pose.from_array(pose) @ scan.T_robot_laser
            last = laser.array() if not len(self.poses) else self.poses[-1]
            self.add(scan, laser, float(np.hypot(*(laser.array() - last)[:2])) + self.driven_m)
        self.known: NDArray[np.int64] = np.arange(self.store.count)
        """(n,) rows of the earlier run"""
        self.begin_m = self.driven_m + CARRIED_M
        """way at which the robot begins"""

    @property
    def driven_m(self) -> float:
        """Way to the last scan."""
        return float(self.travelled_m[-1]) if len(self.travelled_m) else 0.0

    def add(self, scan: Scan, laser: Pose, travelled_m: float) -> int:
        """Keep a scan, whose `laser` is there; its row."""
        self.store.put(scan)
        self.poses = np.vstack([self.poses, laser.array()])
        self.travelled_m = np.append(self.travelled_m, travelled_m)
        return self.store.keep()

    def places(self) -> KnownPlaces:
        """The places of the earlier run, once there is a scan of the robot."""
        places = KnownPlaces(self)
        places.seek(self.known, self.known)
        return places

    def views(self, key: int, at: Array) -> Views:
        """Scan `key` at a pose (3,) and the earlier scans whose views overlap it most."""
        targets = overlapping(self, key, at, self.known)[:_PARTNERS]
        return Views(self.store.returns, key, targets, self.poses[targets])

    def share(self, key: int, at: Array) -> float:
        """The share of the returns that the earlier scans can judge from a pose (3,) that agree with them."""
        agreed = agreement_of(self.views(key, at), at)
        return 1.0 - contradicted(agreed.hits, agreed.through) if agreed.hits > 0.0 else 0.0


class Relocalizer:
    """Looks for the place of a robot among earlier key scans, from poses in a frame of its own."""

    def __init__(self, known: KeyScans, config: Config, expected: Sequence[Pose] = ()) -> None:
        """Search among these scans, with the least score of `config`.

        A place that agrees with one of `expected`, each a `T_map_own`, needs no second find.
        """
        self._expected, self._min_score = tuple(expected), config.scans.min_score
        self._scans, self._search = SoughtScans(known, config), place_search_of(config)
        self._places: KnownPlaces | None = None
        """from the first scan on"""
        self._votes = Votes(self._scans)
        self._last: Pose | None = None
        self.driven_m = 0.0
        """of the scans so far"""
        self.place: Pose | None = None
        """`T_map_own` by what was seen so far, if that fits one place alone; not yet confirmed by a second find"""

    def take(self, scan: Scan, pose: Pose) -> Pose | None:
        """Process a scan at `pose` in the robot's own frame; `T_map_own` once it is certain, None before."""
        moved = Pose() if self._last is None else self._last.inverse() @ pose
        distance_m = math.hypot(moved.x, moved.y)
        if self._last is not None and distance_m + _M_PER_RAD * abs(moved.theta) < _SPACING_M:
            return None
        self._last, self.driven_m = pose, self.driven_m + distance_m
        scans, laser = self._scans, pose @ scan.T_robot_laser
        key = scans.add(scan, laser, scans.begin_m + self.driven_m)
        self._places = places = self._places or scans.places()
        query = PlaceQuery(scans, key, places, ExpectedPoses.anywhere(len(places.anchors)), self._min_score)
        found = best_place(query, self._search)
        if found is None or found.is_ambiguous:
            return None
        self.place = Pose.from_array(found.evidence.pose) @ laser.inverse()
        if any(is_same_place(found.evidence.pose, (T_map_own @ laser).array()) for T_map_own in self._expected):
            return self.place
        return self.place if self._votes.agreeing(key, found.evidence) else None


def located(scan: Scan, prior: PriorMap, pose: Pose, cov: Array, config: Config) -> Pose:
    """The pose at which the first scan fits the map, near `pose` (`T_world_robot`) of covariance `cov` (3, 3).

    It is the pose itself where that is known well. Otherwise it serves to linearize, since the scan says much more of
    the pose than a `cov` this large. Raises InputError where the scan does not fit the map, and where it fits two
    places.
    """
    if not scan.is_return.any() or not prior.scans.scans:
        return pose
    scans, laser = SoughtScans(prior.scans, config), pose @ scan.T_robot_laser
    key = scans.add(scan, laser, scans.begin_m)
    if max(cov[0, 0], cov[1, 1]) <= _KNOWN_M**2 and cov[2, 2] <= _KNOWN_RAD**2:
        _check_share(scans.share(key, laser.array()), prior)
        return pose
    offset = (laser.position - pose.position).tolist()
    cov_laser = move_covariance((-offset[0], -offset[1], 0.0), cov)
    floor = np.diag([_KNOWN_M, _KNOWN_M, _KNOWN_RAD]) ** 2 * 1e-2
    given = Prior(laser.array(), np.asarray(np.linalg.inv(cov_laser + floor), dtype=np.float64))
    candidates = _candidates(scans, key, given, cov_laser)
    _check_share(max((scans.share(key, each.pose) for each in candidates), default=0.0), prior)
    best = judged(scans, np.array([key]), candidates)
    if best.is_ambiguous:
        allowed = "a smaller sigma, or a start from where one scan tells places apart"
        raise InputError("pose_sigma", f"found two places of {prior.name} that the first scan fits", allowed)
    at = best.evidence.pose
    return Pose.from_array(aligned(scans.views(key, at), given, at, WIDE_GATE_M).pose) @ scan.T_robot_laser.inverse()


def _check_share(share: float, prior: PriorMap) -> None:
    if share < _LEAST_SHARE:
        found = f"found {prior.name}, of which the first scan shows {100 * share:.0f} %"
        raise InputError("prior_map", found, "a map of this building, and a start at its place there")


def _candidates(scans: SoughtScans, key: int, given: Prior, cov: Array) -> list[Candidate]:
    """The places that a scan may be from by the map and by the given pose, of covariance `cov` (3, 3).

    Along a wall that hides the place along it the given pose says it: all places there become one.
    """
    places = scans.places()
    count, sigma_m = len(places.anchors), math.sqrt(float(np.linalg.eigvalsh(cov[:2, :2])[-1]))
    sigmas = np.full(count, sigma_m), np.full(count, math.sqrt(cov[2, 2]))
    expected = ExpectedPoses(between(places.anchors, given.pose).reshape(-1, 3), *sigmas)
    found = []
    for each in proposed(PlaceQuery(scans, key, places, expected, LEAST_SCORE), least_points=1):
        pose = aligned(scans.views(key, each.pose), given, each.pose, WIDE_GATE_M).pose
        off = between(given.pose, pose)
        off = np.array([*(pose[:2] - given.pose[:2]), off[2]])
        if off @ given.information @ off <= _MOST_SQUARE:
            found.append(each._replace(pose=pose))
    return distinct(found)
