"""The present solution with its covariances, read when they are asked for: reading takes longer than most updates."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import gtsam
import numpy as np
from gtsam.symbol_shorthand import X
from scipy.linalg import block_diag

from sixthsense.core.geometry import Array, Pose
from sixthsense.core.landmarks import LandmarkId, Observation
from sixthsense.core.motion import STANDSTILL, Odometry, compose_jacobians
from sixthsense.core.se2 import composed_covariance, turned_covariance
from sixthsense.core.sensor import Sensor, SensorEstimate
from sixthsense.core.wheels import PARAMETERS, WheelEstimate, Wheels
from sixthsense.slam.estimators.base import check_parameters
from sixthsense.slam.estimators.isam2_calibration import SENSOR, WHEELS, parameters_factor
from sixthsense.slam.estimators.isam2_chain import Chain, map_gain
from sixthsense.slam.estimators.isam2_factors import lines, to_pose
from sixthsense.slam.estimators.isam2_solver import Landmarks, Solver, Unsolved


class Head:
    """A pose, the wheels' parameters if they are estimated, and their joint covariance."""

    def __init__(self, solver: Solver, pose: Pose, cov: Array) -> None:
        """Begin at a pose, `T_world_robot`, of covariance `cov` (3, 3), without a solution."""
        self.pose = pose
        """of the last solved pose, or the start"""
        self.wheels: Wheels | None = None
        """at the last solution, if they are estimated"""
        self.sensor: Sensor | None = None
        """at the last solution, if its parameters are estimated"""
        self._solver, self._cov = solver, cov
        self._last = 0
        """key of the last solved pose"""
        self._has_cov = True
        """whether the covariance is that of the last solution"""

    def add_wheels(self, prior: WheelEstimate, unsolved: Unsolved, has_begun: bool) -> None:
        """Add the wheels' parameters; RuntimeError if the estimator has begun."""
        check_parameters("wheels", prior, self.wheels is not None or has_begun)
        unsolved.values.insert(WHEELS, prior.values.array())
        unsolved.graph.add(parameters_factor(WHEELS, prior))
        self.wheels, self._cov = prior.values, block_diag(self._cov, prior.cov)

    def wheel_estimate(self) -> WheelEstimate | None:
        """The wheels' parameters, if they are estimated."""
        return None if self.wheels is None else WheelEstimate(self.wheels, self.cov()[3:, 3:].copy())

    def add_sensor(self, prior: SensorEstimate, unsolved: Unsolved, has_begun: bool) -> None:
        """Add the sensor's parameters; RuntimeError if the estimator has begun."""
        check_parameters("sensor", prior, self.sensor is not None or has_begun)
        unsolved.values.insert(SENSOR, prior.values.array())
        unsolved.graph.add(parameters_factor(SENSOR, prior))
        self.sensor, self._sensor_prior = prior.values, prior

    def sensor_estimate(self) -> SensorEstimate | None:
        """The sensor's parameters, if they are estimated."""
        if self.sensor is None or not self.is_solved:
            return None if self.sensor is None else self._sensor_prior
        return SensorEstimate(self.sensor, self._solver.covariance(SENSOR))

    def update(self, last: int) -> None:
        """Take in that there is a new solution, whose last pose has this key."""
        self._last, self._has_cov = last, False
        self.pose = to_pose(self._solver.isam.calculateEstimatePose2(last))
        if self.wheels is not None:
            self.wheels = Wheels.from_array(self._solver.isam.calculateEstimateVector(WHEELS))
        if self.sensor is not None:
            self.sensor = Sensor.from_array(self._solver.isam.calculateEstimateVector(SENSOR))

    def cov(self) -> Array:
        """(3, 3) of the pose, or (8, 8) with the wheels' parameters, world frame."""
        if not self._has_cov:
            self._cov, self._has_cov = self._read_cov(), True
        return self._cov

    def _read_cov(self) -> Array:
        if self.wheels is None:
            cov = np.ascontiguousarray(self._solver.covariance(self._last))
            return np.asarray(turned_covariance(cov, self.pose.theta))
        to_world = self.to_world()
        cov = to_world @ self._solver.joint_covariance(self.keys()) @ to_world.T
        return np.asarray(0.5 * (cov + cov.T))

    @property
    def is_solved(self) -> bool:
        """Whether the pose is a variable of the solver; until then it is the start."""
        return self._last != 0

    def keys(self) -> list[int]:
        """Keys of the variables."""
        return [self._last] if self.wheels is None else [self._last, WHEELS]

    def to_world(self) -> Array:
        """From GTSAM's tangents of these variables to the axes of `cov`."""
        turn = Pose(theta=self.pose.theta).adjoint()
        return turn if self.wheels is None else np.asarray(block_diag(turn, np.eye(PARAMETERS)))

    def motion(self, pending: Odometry) -> Odometry:
        """A motion for the present parameters of the wheels."""
        return pending if self.wheels is None else pending.with_wheels(self.wheels)

    def propagated(self, joint: Array, pending: Odometry) -> Array:
        """Joint covariance (3 + 2k, 3 + 2k) of the pose after the motion `pending`, and of k landmarks; a copy.

        `joint` (n + 2k, n + 2k) is that of the head's n values and the landmarks.
        """
        if len(joint) == 3:
            return self._propagated_pose(joint, pending)
        head = len(self._cov)
        kept = np.concatenate([np.arange(3), np.arange(head, len(joint))])
        if pending is STANDSTILL:
            return np.asarray(joint[np.ix_(kept, kept)])
        motion = self.motion(pending)
        by_pose, by_motion = compose_jacobians(self.pose.theta, motion.motion)
        by_head = np.zeros((3, head))
        by_head[:, :3] = by_pose
        if self.wheels is not None and motion.wheels is not None:
            by_head[:, 3:] = by_motion @ motion.wheels.jacobian
        moved = joint.copy()
        moved[:3] = by_head @ moved[:head]
        moved[:, :3] = moved[:, :head] @ by_head.T
        moved[:3, :3] += by_motion @ motion.cov @ by_motion.T
        moved = moved[np.ix_(kept, kept)]
        return np.asarray(0.5 * (moved + moved.T))

    def _propagated_pose(self, cov: Array, pending: Odometry) -> Array:
        """As `propagated`, of the pose (3, 3) alone."""
        if pending is STANDSTILL:
            return cov.copy()
        moved = composed_covariance(cov, pending.cov, self.pose.theta, pending.motion.x, pending.motion.y)
        return np.asarray(0.5 * (moved + moved.T))


_POINT = np.eye(2)  # a point's errors are those in GTSAM's tangent


class Solution:
    """Poses and landmarks of the last solution, its head included."""

    def __init__(self, solver: Solver, landmarks: Landmarks, head: Head, chain: Chain) -> None:
        """Begin without a solution."""
        self._solver, self._landmarks, self._head, self._chain = solver, landmarks, head, chain
        self._poses: Array | None = np.zeros((0, 3))
        """all poses, once they were asked for"""
        self._in_graph = np.zeros((0, 3))
        self._has_read = True
        """whether poses and landmarks are those of the last solution"""
        self._joint, self._pending = np.zeros((3, 3)), STANDSTILL
        """the last joint covariance that was asked for, and the motion since the solution then"""
        self._rows: dict[LandmarkId, int] = {}
        """of the landmarks in it; none of an earlier solution"""

    def update(self, last: int) -> None:
        """Take in that there is a new solution, whose last pose has this key."""
        self._has_read, self._poses, self._rows = False, None, {}
        self._head.update(last)

    def pose_at(self, k: int) -> Pose:
        """The pose of update k, which is solved."""
        if self._poses is not None:
            return Pose.from_array(self._poses[k])
        anchor, relative = self._chain.anchored(k)
        return to_pose(self._solver.isam.calculateEstimatePose2(X(anchor))) @ relative.motion

    def poses(self) -> Array:
        """(K, 3) all solved poses."""
        self._read()
        if self._poses is None:
            self._poses = self._chain.all_poses(self._in_graph)
        return self._poses

    def landmarks(self) -> Landmarks:
        """The landmarks with their present means."""
        if self._landmarks.keys or len(self._landmarks.means):
            self._read()
        return self._landmarks

    def joint_covariance(self, ids: Sequence[LandmarkId], pending: Odometry) -> Array:
        """(3 + 2k, 3 + 2k) of the pose after a motion since the solution and of the landmarks; KeyError for others."""
        landmarks, cov = self.landmarks(), self._head.cov()
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
        self._joint, self._pending = joint.copy(), pending
        self._rows = {i: 3 + 2 * k for k, i in enumerate(ids)}
        return joint

    def map_gain(self, pose: Pose, observations: Mapping[LandmarkId, Observation], pending: Odometry) -> float:
        """What observations of known landmarks from the pose after a motion say of these in the mean, nats.

        Infinite where nobody has asked for their joint covariance: who matches observations has, and for the gain alone
        it would cost too much.
        """
        if self._pending is not pending or not self._rows.keys() >= observations.keys():
            return math.inf
        asked = np.concatenate([np.arange(3), *(self._rows[i] + np.arange(2) for i in observations)])
        landmarks, joint = self.landmarks(), self._joint[np.ix_(asked, asked)]
        row = {i: k for k, i in enumerate(landmarks.keys)}
        rows = [row[i] for i in observations]
        return map_gain(pose, joint, landmarks.means[rows], landmarks.walls()[rows], list(observations.values()))

    def _read(self) -> None:
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
