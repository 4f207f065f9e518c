"""Landmarks of a prior map that are no longer there: beams go through where they were."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping

import numpy as np

from sixthsense.core.geometry import Array, Pose
from sixthsense.core.landmarks import LandmarkId, Observation
from sixthsense.core.laser import Scan
from sixthsense.slam.association.records import Record
from sixthsense.slam.estimators import Estimate

_GONE = 6
"""keyframes that see through a landmark, from which on it is gone"""
_PER_OBSERVATION = 4
"""keyframes that see through it, which one observation outweighs"""
_BESIDE_M = 0.1
"""of a point to either side, and of a wall's ends: beams there must not tell"""
_BEYOND_M = 0.2
"""a beam that goes this far beyond a landmark, and the uncertainty of the pose, has passed it"""
_AT_M = 0.05
"""a beam that ends this near a wall, and the uncertainty of the pose, ends at it"""
_SIGMAS = 3.0
_LEAST_TURN_RAD = 0.35
"""between two directions from which beams pass a point: an end of a wall is not seen along the wall"""
_LEAST_COSINE = 0.2
"""of a beam's incidence on a wall"""
_LEAST_BEAMS, _LEAST_LENGTH_M, _MOST_STOPPED = 5, 0.3, 0.1
"""beams that pass a wall, what they cover of it, and the share of beams that end at it"""


class Vanished:
    """Counts keyframes that see through landmarks of a prior map."""

    def __init__(self, ids: Collection[LandmarkId], no_return_passes: bool) -> None:
        """Watch the landmarks `ids`; a beam without a return tells only if `no_return_passes`."""
        self._through = dict.fromkeys(ids, 0)
        self._directions: dict[LandmarkId, float] = {}
        """of the first beams that passed a point, rad"""
        self._from_two: set[LandmarkId] = set()
        """points that beams have passed from two directions, and walls"""
        self._no_return_passes = no_return_passes

    def gone(
        self,
        scan: Scan,
        estimate: Estimate,
        observations: Mapping[LandmarkId, Observation],
        records: Mapping[LandmarkId, Record],
    ) -> list[LandmarkId]:
        """Take a keyframe with the estimate and the matches of its update; the landmarks that are gone by now."""
        for i in set(self._through).difference(records):
            del self._through[i]  # culled or merged
        for i in set(self._through).intersection(observations):
            self._through[i] = max(0, self._through[i] - _PER_OBSERVATION)
        watched = [k for k, i in enumerate(estimate.ids.tolist()) if i in self._through and i not in observations]
        if not watched:
            return []
        beams = _Beams(scan, estimate, self._no_return_passes)
        gone: list[LandmarkId] = []
        for k in watched:
            i = int(estimate.ids[k])
            landmark = estimate.landmarks[k]
            if estimate.walls[k]:
                is_through = beams.pass_wall(landmark, records[i].extent)
                self._from_two.add(i)
            elif is_through := beams.pass_point(landmark, records[i].sigma_m):
                direction = beams.direction(landmark)
                turn = direction - self._directions.setdefault(i, direction)
                if abs(math.sin(turn)) >= math.sin(_LEAST_TURN_RAD):
                    self._from_two.add(i)
            self._through[i] += int(is_through)
            if self._through[i] >= _GONE and i in self._from_two:
                gone.append(i)
        for i in gone:
            del self._through[i]
        return gone


class _Beams:
    """The beams of a scan in the world."""

    def __init__(self, scan: Scan, estimate: Estimate, no_return_passes: bool) -> None:
        laser: Pose = estimate.pose @ scan.T_robot_laser
        ranges = scan.ranges.astype(np.float64)
        returned = ranges < scan.max_range
        kept = (ranges > 0.0) & (returned | no_return_passes)
        angles = scan.bearings[kept] + laser.theta
        self._ranges = np.where(returned, ranges, scan.max_range)[kept]
        self._along = np.column_stack([np.cos(angles), np.sin(angles)])
        self._origin, cov = laser.position, estimate.pose_cov
        self._sigma_m, self._sigma_rad = float(np.sqrt(cov[0, 0] + cov[1, 1])), float(np.sqrt(cov[2, 2]))

    def direction(self, point: Array) -> float:
        """Of a point (2,) from the laser, rad, world frame."""
        off = point - self._origin
        return math.atan2(off[1], off[0])

    def pass_point(self, point: Array, sigma_m: float) -> bool:
        """Whether the beams to both sides of a point (2,) all go beyond it."""
        off = point - self._origin
        reach = float(np.hypot(*off))
        if reach < 2.0 * _BESIDE_M or not np.isfinite(sigma_m):
            return False
        ahead = self._along @ off
        across = self._along @ np.array([-off[1], off[0]]) / reach  # sine of the angle to the point
        margin = _BEYOND_M + self._slack(reach) + _SIGMAS * sigma_m
        near = (ahead > 0.0) & (np.abs(across) * reach <= _BESIDE_M + self._slack(reach) + _SIGMAS * sigma_m)
        left, right = near & (across > 0.0), near & (across < 0.0)
        enough = left.sum() >= 2 and right.sum() >= 2
        return bool(enough and (self._ranges[near] > reach + margin).all())

    def pass_wall(self, wall: Array, extent: Array) -> bool:
        """Whether beams from either side go through a wall (2,) of that extent (2, 2), and hardly any end there."""
        normal = np.array([np.cos(wall[0]), np.sin(wall[0])])
        tangent = np.array([-normal[1], normal[0]])
        away = float(normal @ self._origin - wall[1])
        if abs(away) < _BESIDE_M:
            return False
        cosine = -self._along @ normal * np.sign(away)
        meets = cosine > _LEAST_COSINE
        reach = abs(away) / cosine[meets]
        place = self._origin @ tangent + reach * (self._along[meets] @ tangent)
        low, high = np.sort(extent @ tangent)
        slack = self._slack(float(np.hypot(*(extent.mean(axis=0) - self._origin))))
        inside = (place > low + _BESIDE_M + slack) & (place < high - _BESIDE_M - slack)
        beyond = (self._ranges[meets] - reach)[inside]
        across = beyond * cosine[meets][inside]
        passed, stopped = across > _BEYOND_M + slack, np.abs(across) <= _AT_M + slack
        places = place[inside][passed]
        if passed.sum() < _LEAST_BEAMS or np.ptp(places) < _LEAST_LENGTH_M:
            return False
        return bool(stopped.sum() <= _MOST_STOPPED * passed.sum())

    def _slack(self, reach: float) -> float:
        """What the pose's uncertainty may shift, m, at this distance."""
        return _SIGMAS * (self._sigma_m + reach * self._sigma_rad)
