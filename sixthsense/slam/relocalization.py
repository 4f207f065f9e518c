"""Where among the key scans of an earlier run a robot is: at its first scan, or while it drives and does not know.

Both are the search of a loop closure: the earlier run has places as earlier passes have, one of them must fit clearly
better than all others, and a place is that of the scans. A pose that is known roughly is a prior of the first scan's. A
robot that does not know where it is drives with a map of its own; what it has seen lately is searched for, and another
vote some metres later must agree.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from sixthsense.config import Config
from sixthsense.config.errors import InputError
from sixthsense.core.geometry import Array, Pose
from sixthsense.core.laser import Scan
from sixthsense.core.se2 import between, move_covariance
from sixthsense.slam.prior_map import KeyScans, PriorMap
from sixthsense.slam.scans import place_search as search
from sixthsense.slam.scans.agreement import agreement_of, contradicted
from sixthsense.slam.scans.alignment import Prior, Views
from sixthsense.slam.scans.graph import PlacedScans, overlapping
from sixthsense.slam.scans.known_places import CARRIED_M, KnownPlaces
from sixthsense.slam.scans.links import SEEN_SHARE, WIDE_GATE_M
from sixthsense.slam.scans.returns import ScanStore
from sixthsense.slam.scans.tracking import TARGETS, aligned

_SPACING_M, _M_PER_RAD = 0.4, 0.4  # between two scans that are kept, and a turn as a distance
_KNOWN = np.array([0.03, 0.03, 0.02])  # sigmas, m and rad, below which linearization at the given pose is good
_LEAST_SHARE = 0.5  # of the returns that the earlier scans can judge
_MOST_SQUARE = 21.1  # of a first pose: 0.9999 of chi-square with 3 degrees of freedom

FOUND_SIGMA = (0.1, 0.1, 0.05)
"""of a start that was found, m and rad; the first scan makes it precise"""
MOST_DRIVEN_M = 40.0
"""without a place, the robot is taken to be elsewhere"""


class SoughtScans(PlacedScans):
    """Key scans of an earlier run, in its frame, and behind them those of a robot, in a frame of its own."""

    def __init__(self, known: KeyScans, config: Config) -> None:
        """Begin with the earlier run."""
        super().__init__(ScanStore(config.scans.max_range_m))
        self.known: NDArray[np.int64] = np.arange(0)
        """(n,) rows of the earlier run"""
        for scan, pose in zip(known.scans, known.poses, strict=True):
            self.put(scan, Pose.from_array(pose))
        self.known = np.arange(self.count)
        self._places = KnownPlaces(self)

    def put(self, scan: Scan, pose: Pose) -> int:
        """Add a scan from a `pose` of the robot; its row."""
        self.store.put(scan)
        self.add((pose @ scan.T_robot_laser).array())
        if self.count > 1:
            is_first = self.count == len(self.known) + 1
            self.moved(CARRIED_M if is_first else float(np.hypot(*(self.poses[-1] - self.poses[-2])[:2])))
        return self.store.keep()

    @property
    def places(self) -> KnownPlaces:
        """The places of the earlier run, once there is a scan of the robot."""
        self._places.seek(self.known, self.known)
        return self._places

    def views(self, key: int, at: Array) -> Views:
        """Scan `key` at a pose (3,) and the earlier scans whose views overlap it most."""
        targets = overlapping(self, key, at, self.known)[:TARGETS]
        return Views(self.store.returns, key, targets, self.poses[targets], 1.0)


class Relocalizer:
    """Looks for the place of a robot among earlier key scans, from poses in a frame of its own."""

    def __init__(self, known: KeyScans, config: Config) -> None:
        """Search among these scans, with the least score of `config`."""
        self._min_score = config.scans.min_score
        self._scans, self._search = SoughtScans(known, config), search.place_search_of(config)
        self._votes = search.Votes(self._scans)
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
        scans = self._scans
        key, places = scans.put(scan, pose), scans.places
        anywhere = search.ExpectedPoses.anywhere(len(places.anchors))
        found = search.best_place(search.PlaceQuery(scans, key, places, anywhere, self._min_score, 0), self._search)
        if found is None or found.is_ambiguous:
            return None
        self.place = Pose.from_array(found.evidence.pose) @ (pose @ scan.T_robot_laser).inverse()
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
    key, is_known = scans.put(scan, pose), bool((np.diag(cov) <= _KNOWN**2).all())
    offset = pose.position - laser.position
    cov_laser = move_covariance((float(offset[0]), float(offset[1]), 0.0), cov)
    given = Prior(laser.array(), np.asarray(np.linalg.inv(cov_laser + 1e-2 * np.diag(_KNOWN) ** 2), dtype=np.float64))
    candidates = [] if is_known else _candidates(scans, key, given, cov_laser)
    poses = [laser.array()] if is_known else [each.pose for each in candidates]
    share = max((_share(scans, key, at) for at in poses), default=0.0)
    if share < _LEAST_SHARE:
        found = f"found {prior.name}, of which the first scan shows {100 * share:.0f} %"
        raise InputError("prior_map", found, "a map of this building, and a start at its place there")
    if is_known:
        return pose
    best = search.judged(scans, np.array([key]), candidates)
    if best.is_ambiguous:
        allowed = "a smaller sigma, or a start from where one scan tells places apart"
        raise InputError("pose_sigma", f"found two places of {prior.name} that the first scan fits", allowed)
    at = best.evidence.pose
    return Pose.from_array(aligned(scans.views(key, at), given, at, WIDE_GATE_M).pose) @ scan.T_robot_laser.inverse()


def _share(scans: SoughtScans, key: int, at: Array) -> float:
    """The share of the returns that the earlier scans can judge from a pose (3,) that agree with them."""
    agreed = agreement_of(scans.views(key, at), at)
    return 1.0 - contradicted(agreed.hits, agreed.through) if agreed.hits > 0.0 else 0.0


def _candidates(scans: SoughtScans, key: int, given: Prior, cov: Array) -> list[search.Candidate]:
    """The places that a scan may be from by the map and by the given pose, of covariance `cov` (3, 3).

    Along a wall that hides the place along it the given pose says it: all places there become one.
    """
    places = scans.places
    count, sigma_m = len(places.anchors), math.sqrt(float(np.linalg.eigvalsh(cov[:2, :2])[-1]))
    sigmas = np.full(count, sigma_m), np.full(count, math.sqrt(cov[2, 2]))
    expected = search.ExpectedPoses(between(places.anchors, given.pose).reshape(-1, 3), *sigmas)
    found = []
    query = search.PlaceQuery(scans, key, places, expected, SEEN_SHARE, 0)
    for each in search.BranchAndBound().propose(query, least_points=1):
        pose = aligned(scans.views(key, each.pose), given, each.pose, WIDE_GATE_M).pose
        off = np.array([*(pose[:2] - given.pose[:2]), between(given.pose, pose)[2]])
        if off @ given.information @ off <= _MOST_SQUARE:
            found.append(each._replace(pose=pose))
    return search.distinct(found)
