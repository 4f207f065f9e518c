"""Landmarks as seen from a proposed pose, to choose matches by and for nothing else.

Scan matching estimates where the robot is relative to its earlier keyframes. Each landmark is fixed to the keyframe of
its last observation, so that a proposal places the landmarks around the robot, whatever the estimator believes of the
way between. The robot is the origin here, since walls far from the origin have offsets that change with the heading.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from scipy.linalg import block_diag

from sixthsense.core.geometry import Array, Pose
from sixthsense.core.landmark_kernels import predictions
from sixthsense.core.landmarks import LandmarkId, Observation, initialize_landmark
from sixthsense.slam.association.records import ByLandmark, Record
from sixthsense.slam.estimators.base import Estimate

_POSE_COV = np.diag([0.04, 0.04, 0.01]) ** 2  # of a proposed pose, beside what the graph of scans is uncertain of
_MOST_SIGMAS = 0.35, 0.35, 0.2  # landmarks of keyframes that are less certain are not matched
_GATE_SIGMAS = 0.1, 0.1, 0.03  # gates count no more: a proposal that is farther off matches nothing


class ProposedLandmarks:
    """The landmarks that a proposal places with certainty: what an associator asks of an estimator."""

    def __init__(self) -> None:
        self._last: dict[LandmarkId, tuple[int, Observation, Array]] = {}
        """keyframe of the last observation, the landmark as it was observed there, and the ends of a wall (2, 2)"""
        self._here = Estimate.of_pose(Pose(), _POSE_COV)
        self._covs: dict[LandmarkId, Array] = {}
        self.extents = np.zeros((0, 2, 2))
        """(n, 2, 2) ends of the walls of `estimate`, in the robot's frame"""

    def estimate(self) -> Estimate:
        """The landmarks in the robot's frame."""
        return self._here

    def joint_covariance(self, ids: Sequence[LandmarkId]) -> Array:
        """(3 + 2k, 3 + 2k) of the proposed pose and of k landmarks in the robot's frame, in the order asked."""
        return np.asarray(block_diag(_POSE_COV, *(self._covs[i] for i in ids)))

    def place(self, relative: Array, sigmas: Array, estimate: Estimate) -> None:
        """Place the landmarks of an estimate, with their extents.

        `relative` (K, 3) are poses of earlier keyframes in the robot's frame, and `sigmas` (K, 3) of these.
        """
        certain = np.all(sigmas < _MOST_SIGMAS, axis=1)
        ids = [i for i in estimate.ids.tolist() if i in self._last and certain[self._last[i][0]]]
        landmarks, extents = np.zeros((len(ids), 2)), np.zeros((len(ids), 2, 2))
        for k, i in enumerate(ids):
            key, seen, ends = self._last[i]
            pose = Pose(*relative[key].tolist())
            landmarks[k], by_pose, by_z = initialize_landmark(pose, seen)
            extents[k] = pose @ ends
            of_pose = by_pose * np.minimum(sigmas[key], _GATE_SIGMAS)
            self._covs[i] = by_z @ seen.cov @ by_z.T + of_pose @ of_pose.T
        walls = np.array([self._last[i][1].is_wall for i in ids], dtype=np.bool_)
        self._here, self.extents = Estimate(Pose(), _POSE_COV, np.array(ids, dtype=np.int64), landmarks, walls), extents

    def remember(self, key: int, estimate: Estimate, seen: ByLandmark, records: Mapping[LandmarkId, Record]) -> None:
        """Fix the landmarks that keyframe `key` has seen to it, with the extents that `records` has of them."""
        local, _, _ = predictions(estimate.pose.triple(), estimate.landmarks, estimate.walls)
        back, rows = estimate.pose.inverse(), {i: row for row, i in enumerate(estimate.ids.tolist())}
        self._last = {i: last for i, last in self._last.items() if i in rows}
        for i in seen.keys() & rows.keys():
            self._last[i] = key, replace(seen[i], z=local[rows[i]]), back @ records[i].extent
