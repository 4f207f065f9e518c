"""Where in a prior map a run begins, by its first scan; a map of another building is refused."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt, gaussian_filter

from sixthsense.config import GridConfig
from sixthsense.config.errors import InputError
from sixthsense.core.geometry import Array, Pose, wrap_angle
from sixthsense.core.laser import Scan
from sixthsense.slam.mapping.evidence import are_obstacles
from sixthsense.slam.mapping.freespace import Bools
from sixthsense.slam.prior_map import PriorMap
from sixthsense.slam.scans.branch_and_bound import Apart, Window, peaks
from sixthsense.slam.scans.submap import pyramid

_KNOWN_M, _KNOWN_RAD = 0.03, 0.02  # sigmas below which linearization at the given pose is good
_MOST_POINTS = 200
_NEAR_M, _FAR_M = 0.15, 0.3  # a return this near an obstacle is explained by it; this far, in free space, it is not
_LEAST_SHARE, _LEAST_JUDGED = 0.5, 20  # of the returns that the map can judge
_LEAST_SCORE = 0.3
_SIGMAS, _MOST_SQUARE = 3.0, 21.1  # of the window; of a pose in it, 0.9999 of chi-square with 3 degrees of freedom
_APART, _STRETCH = Apart(0.5, 0.2), Apart(1.0, 0.2)
_AS_GOOD_SHARE, _AS_GOOD_SCORE = 0.1, 0.85  # another place with a share less this, and a part of the score, is as good
_SCALE_M, _STEPS = 0.05, 12
_FLAT_M = 1.0  # farther obstacles attract no return
_SMOOTH_CELLS, _WEIGHT = 2.0, 0.3  # of the distances: single cells must not tell a place along a wall


class PriorMapError(InputError):
    """A prior map that does not fit what the robot sees, in one line."""


class _Obstacles(NamedTuple):
    """Cells of a prior map, (H, W)."""

    distance_m: Array
    """from each cell to the nearest obstacle"""
    seen: Bools
    corner: Array
    """(2,) x, y of the corner of cell (0, 0)"""
    cell_m: float

    def at(self, points: Array) -> tuple[NDArray[np.int64], NDArray[np.int64], Bools]:
        """Row and column of points (N, 2), clipped, and which are inside."""
        cells = np.floor((points - self.corner) / self.cell_m).astype(np.int64)
        inside = ((cells >= 0) & (cells < self.distance_m.shape[::-1])).all(axis=1)
        cells = np.clip(cells, 0, np.array(self.distance_m.shape[::-1]) - 1)
        return cells[:, 1], cells[:, 0], np.asarray(inside)


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
    obstacles = _obstacles(prior, config)
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


class _Slopes(NamedTuple):
    """(H, W) slope of the smoothed distance from obstacles, by x and y."""

    by_x: Array
    by_y: Array

    @classmethod
    def of(cls, obstacles: _Obstacles) -> _Slopes:
        """Those of the cells of a map."""
        smooth = gaussian_filter(np.minimum(obstacles.distance_m, _FLAT_M), _SMOOTH_CELLS)
        by_y, by_x = np.gradient(smooth, obstacles.cell_m)
        return cls(by_x, by_y)


def _obstacles(prior: PriorMap, config: GridConfig) -> _Obstacles:
    evidence, rim = prior.evidence, round(1.0 / prior.cell_m)
    low, high = evidence.corners - np.array([[rim], [-rim]])
    shape = tuple((high - low + 1).tolist())
    rows, cols = (evidence.cells - low).T
    occupied, seen = np.zeros(shape, dtype=np.bool_), np.zeros(shape, dtype=np.bool_)
    occupied[rows, cols] = are_obstacles(evidence.hits, evidence.passes, config)
    seen[rows, cols] = evidence.seen
    distance = distance_transform_edt(~occupied) if occupied.any() else np.full(shape, np.inf)
    return _Obstacles(distance * prior.cell_m, seen, low[::-1] * prior.cell_m, prior.cell_m)


def _explained(points: Array, laser: Array, pose: Pose, obstacles: _Obstacles) -> float:
    """Share of the returns (N, 2), robot's frame, that the map explains, of those that it judges.

    0 if it judges too few. What ends in unknown space says nothing, unless an obstacle was in the way.
    """
    ends = pose @ points
    row, col, inside = obstacles.at(ends)
    distance = np.where(inside, obstacles.distance_m[row, col], np.inf)
    explained = distance <= _NEAR_M
    contradicted = inside & obstacles.seen[row, col] & (distance > _FAR_M)
    begin = pose @ laser
    for k in np.flatnonzero(~explained & ~contradicted):
        reach = float(np.hypot(*(ends[k] - begin)))
        share = np.arange(0.0, max(1.0 - _FAR_M / reach, 0.0), 0.5 * obstacles.cell_m / reach)
        r, c, within = obstacles.at(begin + share[:, None] * (ends[k] - begin))
        contradicted[k] = bool((within & (obstacles.distance_m[r, c] == 0.0)).any())
    judged = int(explained.sum() + contradicted.sum())
    return float(explained.sum()) / judged if judged >= min(_LEAST_JUDGED, len(points)) else 0.0


def _check_share(share: float, prior: PriorMap) -> None:
    if share < _LEAST_SHARE:
        found = f"prior_map: found {prior.name}, of which the first scan shows {100 * share:.0f} %"
        raise PriorMapError(f"{found}, allowed: a map of this building, and a start at its place there")


def _places(points: Array, pose: Pose, cov: Array, obstacles: _Obstacles) -> list[_Place]:
    """The places near `pose` where the points may have been seen, the best first."""
    rows, cols = np.nonzero(obstacles.distance_m == 0.0)
    cells = (np.column_stack([cols, rows]) + 0.5) * obstacles.cell_m + obstacles.corner
    sigmas = np.sqrt(np.diag(cov))
    half_rad = min(_SIGMAS * float(sigmas[2]) + _KNOWN_RAD, math.pi)
    window = Window(pose.array(), _SIGMAS * float(sigmas[:2].max()) + _NEAR_M, half_rad)
    slopes = _Slopes.of(obstacles)
    found = []
    floor = np.diag([_KNOWN_M, _KNOWN_M, _KNOWN_RAD]) ** 2 * 1e-2
    information = np.asarray(np.linalg.inv(cov + floor), dtype=np.float64)
    for score, *place in peaks(pyramid(cells), points, window, _LEAST_SCORE, _APART).tolist():
        refined = _refined(points, Pose(*place), pose, information, obstacles, slopes)
        off = refined.array() - pose.array()
        off[2] = wrap_angle(float(off[2]))
        if off @ information @ off <= _MOST_SQUARE:
            found.append(_Place(score, Pose(*place), refined))
    return found


def _refined(points: Array, at: Pose, pose: Pose, information: Array, obstacles: _Obstacles, slopes: _Slopes) -> Pose:
    """Gauss-Newton from `at` on the points' distances from obstacles, under a Cauchy loss, with `pose` as prior."""
    now = at.array()
    for _ in range(_STEPS):
        here = Pose.from_array(now)
        ends = here @ points
        row, col, inside = obstacles.at(ends)
        r = np.where(inside, np.minimum(obstacles.distance_m[row, col], _FLAT_M), _FLAT_M)
        gx, gy = (np.where(inside, slope[row, col], 0.0) for slope in slopes)
        lever = ends - here.position
        J = np.column_stack([gx, gy, gy * lever[:, 0] - gx * lever[:, 1]])
        weighted = _WEIGHT * J / (_SCALE_M**2 + r**2)[:, None]
        off = now - pose.array()
        off[2] = wrap_angle(float(off[2]))
        now = now - np.linalg.solve(information + weighted.T @ J, information @ off + weighted.T @ r)
    return Pose.from_array(now)


def _are_near(one: Pose, other: Pose, apart: Apart) -> bool:
    off = one.inverse() @ other
    return math.hypot(off.x, off.y) < apart.distance_m and abs(off.theta) < apart.turn_rad
