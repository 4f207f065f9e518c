"""Landmarks as seen from a proposed pose, to choose matches by and for nothing else.

Scan matching says where the robot is relative to its earlier keyframes. Each landmark is fixed to the keyframe of its
last observation, so what is proposed places the landmarks around the robot, whatever the estimator believes of the way
between. The robot is the origin here, since walls far from the origin have offsets that change with the heading.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sixthsense.core.geometry import Array, Pose, wrap_angle
from sixthsense.core.landmarks import LandmarkId, Observation
from sixthsense.core.se2 import move_points
from sixthsense.slam.association.records import Record
from sixthsense.slam.estimators.base import Estimate

_SIGMA_M, _SIGMA_RAD = 0.04, 0.01  # of a proposed pose, beside what the graph of scans is uncertain of
_MOST_SIGMA_M, _MOST_SIGMA_RAD = 0.35, 0.2  # landmarks of keyframes that are less certain are not matched
_GATE_SIGMA_M, _GATE_SIGMA_RAD = 0.1, 0.03  # gates count no more: a proposal that is farther off matches nothing


class Proposal(NamedTuple):
    """Where the robot is relative to its earlier keyframes."""

    relative: Array
    """(K, 3) poses of the earlier keyframes in the robot's frame"""
    sigma_m: Array
    """(K,) of their positions"""
    sigma_rad: Array
    """(K,) of their headings"""


class _Last(NamedTuple):
    """A landmark as it was known at its last observation, in the robot's frame then."""

    key: int
    """keyframe"""
    landmark: Array
    """(2,)"""
    extent: Array
    """(2, 2) ends of a wall"""
    cov: Array
    """(2, 2) of the observation"""


class ProposedLandmarks:
    """The landmarks that a proposal places with certainty: what an associator asks of an estimator."""

    def __init__(self) -> None:
        self._last: dict[LandmarkId, _Last] = {}
        self._here = Estimate(Pose(), np.zeros((3, 3)), np.zeros(0, np.int64), np.zeros((0, 2)), np.zeros(0, np.bool_))
        self._covs = np.zeros((0, 2, 2))
        self.extents = np.zeros((0, 2, 2))
        """(n, 2, 2) ends of the walls of `estimate`, in the robot's frame"""

    def estimate(self) -> Estimate:
        """The landmarks in the robot's frame."""
        return self._here

    def joint_covariance(self, ids: Sequence[LandmarkId]) -> Array:
        """(3 + 2k, 3 + 2k) of the proposed pose and of k landmarks in the robot's frame, in the order asked."""
        rows = np.searchsorted(self._here.ids, ids)
        joint = np.zeros((3 + 2 * len(rows), 3 + 2 * len(rows)))
        joint[:3, :3] = self._here.pose_cov
        for k, row in enumerate(rows.tolist()):
            joint[3 + 2 * k : 5 + 2 * k, 3 + 2 * k : 5 + 2 * k] = self._covs[row]
        return joint

    def place(self, proposal: Proposal, estimate: Estimate) -> None:
        """Place the landmarks of an estimate by a proposal, with their extents."""
        rows = np.flatnonzero(np.isin(estimate.ids, list(self._last)))  # others are named by a log
        keys = np.array([self._last[i].key for i in estimate.ids[rows].tolist()], dtype=np.int64)
        certain = (proposal.sigma_m[keys] < _MOST_SIGMA_M) & (proposal.sigma_rad[keys] < _MOST_SIGMA_RAD)
        order = np.flatnonzero(certain)[np.argsort(estimate.ids[rows[certain]])]
        ids, walls, keys = estimate.ids[rows[order]], estimate.walls[rows[order]], keys[order]
        last = [self._last[i] for i in ids.tolist()]
        poses = proposal.relative[keys]
        landmarks = moved(poses, np.array([known.landmark for known in last]).reshape(-1, 2), walls)
        self.extents = move_points(poses, np.array([known.extent for known in last]).reshape(-1, 2, 2))
        pose_cov = np.diag([_SIGMA_M**2, _SIGMA_M**2, _SIGMA_RAD**2])
        self._here = Estimate(Pose(), pose_cov, ids, landmarks, walls)
        covs = np.array([known.cov for known in last]).reshape(-1, 2, 2)
        sigmas = np.column_stack([proposal.sigma_m[keys], proposal.sigma_rad[keys]])
        sigmas = np.minimum(sigmas, (_GATE_SIGMA_M, _GATE_SIGMA_RAD))
        self._covs = _placed_covs(poses, covs, walls, landmarks, sigmas)

    def remember(
        self,
        key: int,
        estimate: Estimate,
        observations: Mapping[LandmarkId, Observation],
        records: Mapping[LandmarkId, Record],
    ) -> None:
        """Fix the landmarks that keyframe `key` has observed to it, with the extents that `records` has of them."""
        rows = {i: row for row, i in enumerate(estimate.ids.tolist())}
        T_robot_world = estimate.pose.inverse().array()[None]
        for i, observation in observations.items():
            if i in rows:
                row = slice(rows[i], rows[i] + 1)
                local = moved(T_robot_world, estimate.landmarks[row], estimate.walls[row])[0]
                extent = move_points(T_robot_world, records[i].extent[None])[0]
                self._last[i] = _Last(key, local, extent, observation.cov)
        for i in set(self._last).difference(rows):
            del self._last[i]


def moved(poses: Array, landmarks: Array, walls: NDArray[np.bool_]) -> Array:
    """(n, 2) landmarks in frame a, of those in frames b at `T_a_b` (n, 3), or (1, 3) for all."""
    points = move_points(poses, landmarks[:, None, :])[:, 0]
    alpha = wrap_angle(landmarks[:, 0] + poses[:, 2])
    offset = landmarks[:, 1] + np.cos(alpha) * poses[:, 0] + np.sin(alpha) * poses[:, 1]
    return np.where(walls[:, None], np.column_stack([alpha, offset]), points)


def _placed_covs(poses: Array, covs: Array, walls: NDArray[np.bool_], landmarks: Array, sigmas: Array) -> Array:
    """(n, 2, 2) of landmarks in the robot's frame: of their last observation, `covs`, and of the proposal.

    `poses` (n, 3) of the keyframes of their last observations, `landmarks` (n, 2) in the robot's frame, `sigmas` (n, 2)
    of those poses, m and rad.
    """
    by_pose, by_z = np.zeros((len(walls), 2, 3)), np.zeros((len(walls), 2, 2))
    c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    by_z[:, 0, 0], by_z[:, 0, 1], by_z[:, 1, 0], by_z[:, 1, 1] = c, -s, s, c
    by_pose[:, 0, 0] = by_pose[:, 1, 1] = 1.0
    by_pose[:, 0, 2], by_pose[:, 1, 2] = poses[:, 1] - landmarks[:, 1], landmarks[:, 0] - poses[:, 0]
    c, s = np.cos(landmarks[walls, 0]), np.sin(landmarks[walls, 0])
    lever = c * poses[walls, 1] - s * poses[walls, 0]
    by_z[walls] = np.eye(2)
    by_z[walls, 1, 0] = lever
    by_pose[walls] = 0.0
    by_pose[walls, 0, 2] = 1.0
    by_pose[walls, 1] = np.column_stack([c, s, lever])
    variances = np.column_stack([sigmas[:, 0], sigmas[:, 0], sigmas[:, 1]]) ** 2
    return np.asarray(
        by_z @ covs @ by_z.transpose(0, 2, 1) + (by_pose * variances[:, None, :]) @ by_pose.transpose(0, 2, 1)
    )
