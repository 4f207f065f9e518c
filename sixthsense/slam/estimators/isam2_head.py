"""The smoother's last solved pose, with the wheels' parameters if they are estimated, and motion since then."""

from __future__ import annotations

import numpy as np
from scipy.linalg import block_diag

from sixthsense.core.covariance import composed_covariance, turned_covariance
from sixthsense.core.geometry import Array, Pose
from sixthsense.core.motion import STANDSTILL, Odometry, compose_jacobians
from sixthsense.core.sensor import Sensor, SensorEstimate
from sixthsense.core.wheels import PARAMETERS, WheelEstimate, Wheels
from sixthsense.slam.estimators.base import check_parameters
from sixthsense.slam.estimators.isam2_calibration import SENSOR, WHEELS, parameters_factor
from sixthsense.slam.estimators.isam2_factors import to_pose
from sixthsense.slam.estimators.isam2_solver import Solver
from sixthsense.slam.estimators.isam2_state import Unsolved


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
