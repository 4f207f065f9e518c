"""The solver's present solution, read when it is asked for: reading all poses takes longer than most updates."""

from __future__ import annotations

import gtsam
import numpy as np
from gtsam.symbol_shorthand import X

from sixthsense.core.geometry import Array, Pose
from sixthsense.slam.estimators.isam2_chain import Chain
from sixthsense.slam.estimators.isam2_factors import to_pose
from sixthsense.slam.estimators.isam2_head import Head
from sixthsense.slam.estimators.isam2_solver import Solver
from sixthsense.slam.estimators.isam2_state import Landmarks
from sixthsense.slam.estimators.isam2_walls import lines

_POINT = np.eye(2)  # a point's errors are those in GTSAM's tangent


class Solution:
    """Poses and landmarks of the last solution, its head included."""

    def __init__(self, solver: Solver, landmarks: Landmarks, head: Head, chain: Chain) -> None:
        """Begin without a solution."""
        self._solver, self._landmarks, self._head, self._chain = solver, landmarks, head, chain
        self.count = 0
        """of solutions so far"""
        self._poses: Array | None = np.zeros((0, 3))
        """all poses, once they were asked for"""
        self._in_graph = np.zeros((0, 3))
        self._has_read = True
        """whether poses and landmarks are those of the last solution"""

    def update(self, last: int) -> None:
        """Take in that there is a new solution, whose last pose has this key."""
        self._has_read, self._poses = False, None
        self.count += 1
        self._head.update(last)

    def pose_at(self, k: int) -> Pose:
        """The pose of update k, which is solved."""
        if self._poses is not None:
            return Pose.from_array(self._poses[k])
        anchor, relative = self._chain.anchored(k)
        return to_pose(self._solver.isam.calculateEstimatePose2(X(anchor))) @ relative.motion

    def poses(self) -> Array:
        """(K, 3) all solved poses."""
        self.read()
        if self._poses is None:
            self._poses = self._chain.all_poses(self._in_graph)
        return self._poses

    def landmarks(self) -> Landmarks:
        """The landmarks with their present means."""
        if self._landmarks.keys or len(self._landmarks.means):
            self.read()
        return self._landmarks

    def read(self) -> None:
        """Read poses and landmarks from the solver, if they are not those of the last solution."""
        if self._has_read:
            return
        landmarks = self._landmarks
        values = self._solver.isam.calculateEstimate()
        frames = np.asarray(gtsam.utilities.extractPose2(values)).reshape(-1, 3)
        points = np.zeros((0, 2))
        is_wall = landmarks.walls()
        if len(is_wall):
            points = np.asarray(gtsam.utilities.extractPoint2(values)).reshape(-1, 2)
            points = points[: np.count_nonzero(~is_wall)]  # GTSAM adds empty rows for vectors of another size: wheels
        # In the order of their keys: the letters of apparent walls, of walls and of poses, then the number.
        apparent = len(landmarks.stretches)
        _, walls, self._in_graph = np.split(frames, [apparent, apparent + np.count_nonzero(is_wall)])
        means, axes = lines(walls)
        landmarks.means = np.empty((len(is_wall), 2))
        landmarks.means[is_wall], landmarks.means[~is_wall] = means, points
        of_walls = iter(axes)
        landmarks.by_tangent = {i: next(of_walls) if wall else _POINT for i, wall in landmarks.is_wall.items()}
        self._has_read = True
