"""Where in a prior map a run begins, by its first scan; a map of another building is refused."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from sixthsense.config import GridConfig
from sixthsense.config.errors import InputError
from sixthsense.core.geometry import Array, Pose
from sixthsense.core.laser import Scan
from sixthsense.core.se2 import transformed_covariance
from sixthsense.slam.prior_map import PriorMap
from sixthsense.slam.scans.alignment import Prior, Views
from sixthsense.slam.scans.links import WIDE_GATE_M
from sixthsense.slam.scans.map_views import MapViews
from sixthsense.slam.scans.place_search import MOST_POINTS, is_same_place
from sixthsense.slam.scans.places import PLACE, Window, peaks, pyramid
from sixthsense.slam.scans.tracking import LEAST_SCORE, Aligned, aligned
from sixthsense.slam.scans.visibility import Agreement, judged

_KNOWN_M, _KNOWN_RAD = 0.03, 0.02  # sigmas below which linearization at the given pose is good
_LEAST_SHARE = 0.5  # of the returns that the map can judge
_SIGMAS, _MOST_SQUARE = 3.0, 21.1  # of the window; of a pose in it, 0.9999 of chi-square with 3 degrees of freedom
_WEAK = 1.0  # information where the scan alone says the pose
_STRETCH_M = 1.0  # along a wall that hides the place along it; a shorter one is matched by landmarks
_AS_GOOD = 0.85  # another place that explains at least this part is as good


class _Place(NamedTuple):
    alone: Aligned
    """by the scan alone"""
    both: Aligned
    """by the scan and the given pose"""

    @property
    def quality(self) -> float:
        """Share of the returns that the map explains, less what it contradicts, at either pose."""
        return min(each.support * (1.0 - each.agreement.share) for each in self)

    def is_same(self, other: _Place) -> bool:
        """Whether both are one place, or a stretch along a wall."""
        off = self.alone.pose - other.alone.pose
        return math.hypot(off[0], off[1]) < _STRETCH_M and is_same_place(self.both.pose, other.both.pose)


def located(scan: Scan, prior: PriorMap, pose: Pose, cov: Array, config: GridConfig) -> Pose:
    """The pose at which the first scan fits the map, near `pose` (`T_world_robot`) of covariance `cov` (3, 3).

    It is the pose itself where that is known well. Otherwise it serves to linearize, since the scan says much more of
    the pose than a `cov` this large. Raises InputError where the scan does not fit the map, and where it fits two
    places.
    """
    returned = (scan.ranges > 0.0) & (scan.ranges < scan.max_range)
    if not returned.any() or not len(prior.evidence.cells):
        return pose
    views, laser = MapViews(prior.evidence, config, scan), pose @ scan.T_robot_laser
    key = views.add(scan, laser)
    if max(cov[0, 0], cov[1, 1]) <= _KNOWN_M**2 and cov[2, 2] <= _KNOWN_RAD**2:
        _check_share(_share(Agreement(*judged(_views(views, key, laser.array()), laser.array()))), prior)
        return pose
    c, s = math.cos(pose.theta), math.sin(pose.theta)
    x, y = scan.T_robot_laser.position
    places = _places(views, key, laser.array(), transformed_covariance(cov, 1.0, 0.0, -s * x - c * y, c * x - s * y))
    _check_share(max((_share(place.both.agreement) for place in places), default=0.0), prior)
    best = max(places, key=lambda place: place.quality)
    if any(other.quality >= _AS_GOOD * best.quality and not other.is_same(best) for other in places):
        allowed = "a smaller sigma, or a start from where one scan tells places apart"
        raise InputError("pose_sigma", f"found two places of {prior.name} that the first scan fits", allowed)
    return Pose.from_array(best.both.pose) @ scan.T_robot_laser.inverse()


def _views(views: MapViews, key: int, at: Array) -> Views:
    targets = views.partners(key, at, 1)
    return Views(views.store.returns, key, targets, views.poses[targets])


def _share(agreement: Agreement) -> float:
    return 1.0 - agreement.share if agreement.hits > 0.0 else 0.0


def _check_share(share: float, prior: PriorMap) -> None:
    if share < _LEAST_SHARE:
        found = f"found {prior.name}, of which the first scan shows {100 * share:.0f} %"
        raise InputError("prior_map", found, "a map of this building, and a start at its place there")


def _places(views: MapViews, key: int, laser: Array, cov: Array) -> list[_Place]:
    """The places near `laser` (3,), of covariance `cov` (3, 3), that a scan may be from; none without obstacles."""
    own = views.store.returns.points[key]
    own = own[own[:, 2] > 0.0, :2].astype(np.float64)
    obstacles = views.obstacles
    if not len(obstacles) or not len(own):
        return []
    own = own[np.linspace(0, len(own) - 1, min(len(own), MOST_POINTS)).astype(np.int64)]
    sigmas = np.sqrt(np.diag(cov))
    half_rad = min(_SIGMAS * float(sigmas[2]) + _KNOWN_RAD, math.pi)
    window = Window(laser, _SIGMAS * float(sigmas[:2].max()) + _KNOWN_M, half_rad)
    floor = np.diag([_KNOWN_M, _KNOWN_M, _KNOWN_RAD]) ** 2 * 1e-2
    prior = Prior(laser, np.asarray(np.linalg.inv(cov + floor), dtype=np.float64))
    places = []
    for at in peaks(pyramid(obstacles), own, window, LEAST_SCORE, PLACE)[:, 1:]:
        alone = aligned(_views(views, key, at), Prior(at, _WEAK * np.eye(3)), at, WIDE_GATE_M)
        both = aligned(_views(views, key, alone.pose), prior, alone.pose, WIDE_GATE_M)
        if both.slip <= _MOST_SQUARE:
            places.append(_Place(alone, both))
    return places
