"""Where in a prior map a run begins, by its first scan; a map of another building is refused."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from sixthsense.config import GridConfig
from sixthsense.core.geometry import Array, Pose, wrap_angle
from sixthsense.core.laser import Scan
from sixthsense.slam.map_fit import NEAR_M, Obstacles, fitted, judged
from sixthsense.slam.prior_map import PriorMap, PriorMapError
from sixthsense.slam.scans.branch_and_bound import Apart, Window, peaks
from sixthsense.slam.scans.submap import pyramid

_KNOWN_M, _KNOWN_RAD = 0.03, 0.02  # sigmas below which linearization at the given pose is good
_MOST_POINTS = 200
_LEAST_SHARE, _LEAST_JUDGED = 0.5, 20  # of the returns that the map can judge
_LEAST_SCORE = 0.3
_SIGMAS, _MOST_SQUARE = 3.0, 21.1  # of the window; of a pose in it, 0.9999 of chi-square with 3 degrees of freedom
_APART, _STRETCH = Apart(0.5, 0.2), Apart(1.0, 0.2)
_AS_GOOD_SHARE, _AS_GOOD_SCORE = 0.1, 0.85  # another place with a share less this, and a part of the score, is as good


class _Place(NamedTuple):
    """A pose at which the first scan fits the map."""

    score: float
    found: Pose
    """by the scan alone"""
    pose: Pose
    """by the scan and the given pose"""

    def is_same(self, other: _Place) -> bool:
        """Whether both are one place, or a stretch along a wall that is short enough to be matched."""
        return _are_near(self.pose, other.pose, _APART) and _are_near(self.found, other.found, _STRETCH)


def located(scan: Scan, prior: PriorMap, pose: Pose, cov: Array, config: GridConfig) -> Pose:
    """The pose at which the first scan fits the map, near `pose` (`T_world_robot`) of covariance `cov` (3, 3).

    It is the pose itself where that is known well. Otherwise it serves to linearize, since the scan says much more of
    the pose than a `cov` this large. Raises PriorMapError where the scan does not fit the map, and where it fits two
    places.
    """
    returned = (scan.ranges > 0.0) & (scan.ranges < scan.max_range)
    points = scan.points_robot[returned]
    if not len(points) or not len(prior.evidence.cells):
        return pose
    points = points[np.linspace(0, len(points) - 1, min(len(points), _MOST_POINTS)).astype(np.int64)]
    obstacles = Obstacles.of(prior.evidence, config)
    laser = scan.T_robot_laser.position
    if max(cov[0, 0], cov[1, 1]) <= _KNOWN_M**2 and cov[2, 2] <= _KNOWN_RAD**2:
        share = _explained(points, laser, pose, obstacles)
        _check_share(share, prior)
        return pose
    found = _places(points, pose, cov, obstacles)
    shares = [_explained(points, laser, place.pose, obstacles) for place in found]
    _check_share(max(shares, default=0.0), prior)
    best = max(range(len(found)), key=lambda k: found[k].score * (shares[k] >= _LEAST_SHARE))
    for place, share in zip(found, shares, strict=True):
        as_good = place.score >= _AS_GOOD_SCORE * found[best].score and share >= shares[best] - _AS_GOOD_SHARE
        if as_good and not place.is_same(found[best]):
            allowed = "allowed: a smaller sigma, or a start from where one scan tells places apart"
            raise PriorMapError(f"pose_sigma: found two places of {prior.name} that the first scan fits, {allowed}")
    return found[best].pose


def _explained(points: Array, laser: Array, pose: Pose, obstacles: Obstacles) -> float:
    """Share of the returns (N, 2), robot's frame, that the map explains, of those that it judges; 0 of too few."""
    explained, contradicted = judged(pose @ points, pose @ laser, obstacles)
    count = explained + contradicted
    return explained / count if count >= min(_LEAST_JUDGED, len(points)) else 0.0


def _check_share(share: float, prior: PriorMap) -> None:
    if share < _LEAST_SHARE:
        found = f"prior_map: found {prior.name}, of which the first scan shows {100 * share:.0f} %"
        raise PriorMapError(f"{found}, allowed: a map of this building, and a start at its place there")


def _places(points: Array, pose: Pose, cov: Array, obstacles: Obstacles) -> list[_Place]:
    """The places near `pose` where the points may have been seen, the best first; none in a map without obstacles."""
    if not len(obstacles.centres):
        return []
    sigmas = np.sqrt(np.diag(cov))
    half_rad = min(_SIGMAS * float(sigmas[2]) + _KNOWN_RAD, math.pi)
    window = Window(pose.array(), _SIGMAS * float(sigmas[:2].max()) + NEAR_M, half_rad)
    found = []
    floor = np.diag([_KNOWN_M, _KNOWN_M, _KNOWN_RAD]) ** 2 * 1e-2
    information = np.asarray(np.linalg.inv(cov + floor), dtype=np.float64)
    for score, *place in peaks(pyramid(obstacles.centres), points, window, _LEAST_SCORE, _APART).tolist():
        refined = fitted(points, Pose(*place), obstacles, pose, information)
        off = refined.array() - pose.array()
        off[2] = wrap_angle(float(off[2]))
        if off @ information @ off <= _MOST_SQUARE:
            found.append(_Place(score, Pose(*place), refined))
    return found


def _are_near(one: Pose, other: Pose, apart: Apart) -> bool:
    off = one.inverse() @ other
    return math.hypot(off.x, off.y) < apart.distance_m and abs(off.theta) < apart.turn_rad
