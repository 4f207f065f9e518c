"""Joint covariances of the pose and landmarks, read from the solver."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from scipy.linalg import block_diag

from sixthsense.core.geometry import Array, Pose
from sixthsense.core.landmarks import LandmarkId, Observation
from sixthsense.core.motion import STANDSTILL, Odometry
from sixthsense.slam.estimators.isam2_chain import map_gain
from sixthsense.slam.estimators.isam2_head import Head
from sixthsense.slam.estimators.isam2_solution import Solution
from sixthsense.slam.estimators.isam2_solver import Solver


class JointCovariances:
    """Reads joint covariances, and keeps the last one: a query takes longer than all else of a keyframe."""

    def __init__(self, solver: Solver, solution: Solution, head: Head) -> None:
        """Of the solver's present solution."""
        self._solver, self._solution, self._head = solver, solution, head
        self._rows: dict[LandmarkId, int] = {}
        """of the landmarks in the last one"""
        self._last = np.zeros((3, 3))
        self._of, self._pending = -1, STANDSTILL
        """the solution that the last one is of, and the motion since that"""

    def read(self, ids: Sequence[LandmarkId], pending: Odometry) -> Array:
        """(3 + 2k, 3 + 2k) of the pose after a motion since the solution and of the landmarks; KeyError for others."""
        landmarks, cov = self._solution.landmarks(), self._head.cov()
        keys = [landmarks.keys[i] for i in ids]
        if not keys:
            return self._head.propagated(cov, pending)
        # GTSAM answers in the order of the query, each variable in its own tangent.
        to_world, of_head = [landmarks.by_tangent[i] for i in ids], self._head.is_solved
        joint = self._solver.joint_covariance([*self._head.keys(), *keys] if of_head else keys)
        to_axes = block_diag(*([self._head.to_world()] if of_head else []), *to_world)
        joint = to_axes @ joint @ to_axes.T
        if not of_head:  # landmarks of an earlier run, and the start
            joint = block_diag(cov, joint)
        joint[: len(cov), : len(cov)] = cov
        joint = self._head.propagated(0.5 * (joint + joint.T), pending)
        self._rows, self._last = {i: 3 + 2 * k for k, i in enumerate(ids)}, joint.copy()
        self._of, self._pending = self._solution.count, pending
        return joint

    def map_gain(self, pose: Pose, observations: Mapping[LandmarkId, Observation], pending: Odometry) -> float:
        """What observations of known landmarks from the pose after a motion say of these in the mean, nats.

        Infinite where nobody has asked for their joint covariance: who matches observations has, and for the gain alone
        it would cost too much.
        """
        is_present = self._of == self._solution.count and self._pending is pending
        if not is_present or not self._rows.keys() >= observations.keys():
            return math.inf
        asked = np.concatenate([np.arange(3), *(self._rows[i] + np.arange(2) for i in observations)])
        landmarks, joint = self._solution.landmarks(), self._last[np.ix_(asked, asked)]
        row = {i: k for k, i in enumerate(landmarks.keys)}
        rows = [row[i] for i in observations]
        return map_gain(pose, joint, landmarks.means[rows], landmarks.walls()[rows], list(observations.values()))
