"""The report's EKF-SLAM: one joint Gaussian over the pose and all landmarks (Smith, Self and Cheeseman 1990)."""

from __future__ import annotations

from array import array
from collections.abc import Collection, Mapping, Sequence
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag, solve_triangular

from sixthsense.core.covariance import check_covariance, plus_blocks
from sixthsense.core.geometry import Array, Pose, wrap_angle
from sixthsense.core.landmark_kernels import innovations_of, predictions, stacked, translations
from sixthsense.core.landmarks import LandmarkId, Observation, initialize_landmark, observed_centre, rotation_generator
from sixthsense.core.motion import STANDSTILL, Odometry
from sixthsense.core.parameters import P, ParameterEstimate
from sixthsense.core.se2 import move_covariance
from sixthsense.core.sensor import Sensor
from sixthsense.core.wheels import Wheels
from sixthsense.slam.estimators.base import Estimate, LandmarkPrior, check_observations, check_parameters, check_prior


class EKF:
    """EKF-SLAM with one batch update per keyframe.

    State: x, y, theta of the robot, the wheels' parameters if they are estimated, then two numbers for each landmark.
    Internally the world's origin is the start, since a wall's (alpha, d) about a far origin linearizes badly: a turn of
    a short wall about its middle shifts d by d/2 times the square of the turn. The linearized system loses an
    unobservable direction, the heading of the whole map, so that the filter is overconfident once the robot has turned
    (Huang, Mourikis and Roumeliotis 2010). The invariant filter, which keeps that direction, overrides
    `_apply_correction`. It also takes a wall's offset from a centre on the wall. The standard filter would lose more by
    the heading that it gains about such a centre.
    """

    _has_centres: ClassVar[bool] = False

    def __init__(self, start: Pose, start_cov: Array) -> None:
        """Start at `start` (world frame) with `start_cov` (3, 3), which may be zero; ValueError if that is invalid."""
        cov = check_covariance("start_cov", start_cov)
        self._origin = start.position
        self._pose = Pose(0.0, 0.0, start.theta)
        self._means = np.zeros((0, 2))
        self._walls = np.zeros(0, dtype=np.bool_)
        self._centres = np.zeros((0, 2))
        """(n, 2) of walls, or zero; zero for points"""
        self._cov = np.array(cov)
        """(n, n) of the state, symmetric to the last bit"""
        self._slots: dict[LandmarkId, int] = {}
        self._parameters: dict[Any, Any] = {}
        """values of the parameters by their class, `Wheels` or `Sensor`, if they are estimated"""
        self._at: dict[Any, slice] = {}
        """where these are in the state"""
        self._head = 3
        """size of the state before the landmarks"""
        self._pending = STANDSTILL
        self._has_begun = False
        """whether it has moved, or has landmarks"""
        self._trajectory = array("d")
        """x, y and theta at each update, which are returned without a loop over them"""

    def start_from(self, prior: LandmarkPrior) -> None:
        """Begin with the landmarks of an earlier run: the joint covariance has a block more."""
        check_prior(prior, self._has_begun)
        middles = prior.extents.mean(axis=1) - self._origin
        self._centres = np.where(prior.walls[:, None] & self._has_centres, middles, 0.0)
        means, jacobian = translations(prior.landmarks, prior.walls, -(self._origin + self._centres))
        to_start = block_diag(*jacobian) if len(jacobian) else np.zeros((0, 0))
        cov = to_start @ prior.cov @ to_start.T
        self._cov = block_diag(self._cov, 0.5 * (cov + cov.T))
        self._means, self._walls = means, prior.walls.copy()
        self._slots, self._has_begun = {i: k for k, i in enumerate(prior.ids.tolist())}, len(prior.ids) > 0

    def calibrate(self, prior: ParameterEstimate[Any]) -> None:
        """Add the parameters of the wheels, or of the sensor of points, to the state."""
        kind, end = type(prior.values), self._head + len(prior.cov)
        check_parameters(prior, self._has_begun or kind in self._parameters)
        self._parameters[kind], self._at[kind], self._head = prior.values, slice(self._head, end), end
        self._cov = block_diag(self._cov, prior.cov)

    def calibration(self, of: type[P]) -> ParameterEstimate[P] | None:
        """The parameters of this kind, if they are estimated."""
        if of not in self._parameters:
            return None
        return ParameterEstimate(self._parameters[of], self._cov[self._at[of], self._at[of]].copy())

    def predict(self, odometry: Odometry) -> None:
        """Move by an increment; the covariance is propagated at the next call that needs it.

        Composing increments first is exact: the Jacobians of composed motions multiply.
        """
        check_covariance("odometry", odometry.cov)
        if odometry.is_standstill():
            return
        self._pending, self._has_begun = self._pending.then(odometry), True

    def update(self, observations: Mapping[LandmarkId, Observation]) -> None:
        """Update with all known landmarks at once, then augment the state with the new ones (report section 4.3)."""
        check_observations(observations)
        self._propagate()
        observations = self._sensed(observations)
        known = [i for i in observations if i in self._slots]
        if known:
            slots = np.array([self._slots[i] for i in known], dtype=np.int64)
            shift = self._correct(slots, [observations[i] for i in known])
            for kind, at in self._at.items():
                self._parameters[kind] = kind.from_array(self._parameters[kind].array() + shift[at])
            self._apply_correction(np.concatenate([shift[:3], shift[self._head :]]))
            observations = self._sensed(observations)
        self._augment({i: observation for i, observation in observations.items() if i not in self._slots})
        self._trajectory.extend(self._in_world(self._pose).array())

    def forget(self, ids: Collection[LandmarkId]) -> None:
        """Marginalize landmarks out: remove their rows and columns of the covariance."""
        gone = {self._slots[i] for i in ids}
        if not gone:
            return
        keep = [(i, slot) for i, slot in self._slots.items() if slot not in gone]
        slots = np.array([slot for _, slot in keep], dtype=np.int64)
        kept = np.concatenate([np.arange(self._head), self._places(slots)])
        self._cov = self._cov[np.ix_(kept, kept)]
        self._means, self._walls, self._centres = self._means[slots], self._walls[slots], self._centres[slots]
        self._slots = {i: k for k, (i, _) in enumerate(keep)}

    def estimate(self) -> Estimate:
        """The pose with all motion so far, its covariance, and the landmarks' means."""
        self._propagate()
        landmarks, _ = translations(self._means, self._walls, self._origin + self._centres)
        ids = np.array(list(self._slots), dtype=np.int64)
        return Estimate(self._in_world(self._pose), self._cov[:3, :3].copy(), ids, landmarks, self._walls.copy())

    def joint_covariance(self, ids: Sequence[LandmarkId]) -> Array:
        """(3 + 2k, 3 + 2k) of the pose and the landmarks asked for, in that order."""
        self._propagate()
        slots = np.array([self._slots[i] for i in ids], dtype=np.int64)
        index = np.concatenate([np.arange(3), self._places(slots)])
        joint = np.asarray(self._cov[np.ix_(index, index)])
        _, jacobian = translations(self._means[slots], self._walls[slots], self._origin + self._centres[slots])
        for k in np.flatnonzero(self._walls[slots]):
            at = slice(3 + 2 * k, 5 + 2 * k)
            joint[at] = jacobian[k] @ joint[at]
            joint[:, at] = joint[:, at] @ jacobian[k].T
        return joint

    def trajectory(self) -> Array:
        """(K, 3), the filtered pose at each update."""
        return np.array(self._trajectory).reshape(-1, 3)

    def _apply_correction(self, shift: Array) -> None:
        """Correct the pose and all landmarks by `shift` (3 + 2n,)."""
        self._pose = Pose.from_array(self._pose.array() + shift[:3])
        self._means += shift[3:].reshape(-1, 2)
        self._means[self._walls, 0] = wrap_angle(self._means[self._walls, 0])

    def _sensed(self, observations: Mapping[LandmarkId, Observation]) -> Mapping[LandmarkId, Observation]:
        """The observations for the present parameters of the sensor, if they are estimated."""
        sensor = self._parameters.get(Sensor)
        return {i: seen.with_sensor(sensor) for i, seen in observations.items()} if sensor else observations

    def _in_world(self, pose: Pose) -> Pose:
        return Pose(pose.x + self._origin[0], pose.y + self._origin[1], pose.theta)

    def _places(self, slots: NDArray[np.int64]) -> NDArray[np.int64]:
        """(2k,) places in the state of the landmarks in `slots`."""
        return (self._head + 2 * slots[:, None] + np.arange(2)).ravel()

    def _propagate(self) -> None:
        """Sigma = Phi Sigma Phi^T + G Q G^T, the correct form of the report's eq. 8-9, on pose and wheels.

        The columns of Phi for the wheels' parameters w are G d motion / d w.
        """
        if self._pending is STANDSTILL:
            return
        wheels = self._parameters.get(Wheels)
        pending = self._pending if wheels is None else self._pending.with_wheels(wheels)
        pose = self._pose @ pending.motion
        by_head = np.eye(self._head)
        by_head[:2, 2] = rotation_generator(pose.position - self._pose.position)
        if wheels is not None and pending.wheels is not None:
            by_head[:3, self._at[Wheels]] = Pose(theta=pose.theta).adjoint() @ pending.wheels.jacobian
        k = self._head
        head = by_head @ self._cov[:k]
        own = head[:, :k] @ by_head.T
        own[:3, :3] += move_covariance((0.0, 0.0, pose.theta), pending.cov)
        self._cov[:k, k:], self._cov[k:, :k], self._cov[:k, :k] = head[:, k:], head[:, k:].T, 0.5 * (own + own.T)
        self._pose = pose
        self._pending = STANDSTILL

    def _correct(self, slots: NDArray[np.int64], observations: list[Observation]) -> Array:
        """One batch update (report eq. 10): Sigma -= W W^T with W = Sigma H^T S^-1/2.

        Returns the correction (3 + 2n,) of the state, which the caller applies.
        """
        walls = self._walls[slots]
        about_start, by_mean = translations(self._means[slots], walls, self._centres[slots])
        predicted, by_pose, by_landmark = predictions(self._pose.triple(), about_start, walls)
        z, cov = np.array([s.z for s in observations]), np.array([s.cov for s in observations])
        innovation, noise = innovations_of(z, cov, predicted, walls)
        by_landmark[..., 0] += by_landmark[..., 1] * by_mean[:, 1, :1]  # of `by_mean` this alone is not the identity's
        H = stacked(by_pose, by_landmark, self._head)  # the non-zero columns of H
        for k, observation in enumerate(observations):
            if observation.sensor is not None:
                sensor = self._parameters[Sensor]
                # At the observed point its noise would be in the Jacobian, which biases the parameters.
                H[2 * k : 2 * k + 2, self._at[Sensor]] = -sensor.jacobian(sensor.reported(predicted[k]))
        index = np.concatenate([np.arange(self._head), self._places(slots)])
        cross = H @ self._cov[index]  # (2m, n)
        root = np.linalg.cholesky(plus_blocks(cross[:, index] @ H.T, noise))
        W = solve_triangular(root, cross, lower=True).T  # (n, 2m)
        self._cov -= W @ W.T
        return np.asarray(W @ solve_triangular(root, innovation.ravel(), lower=True))

    def _augment(self, observations: Mapping[LandmarkId, Observation]) -> None:
        """Append new landmarks, initialized at the pose of this update."""
        if not observations:
            return
        self._has_begun = True
        G, noise, means, centres = np.zeros((2 * len(observations), self._head)), [], [], []
        for j, seen in enumerate(observations.values()):
            centre = np.zeros(2)
            if self._has_centres and seen.is_wall:
                centre = self._pose @ observed_centre(seen)
            mean, by_pose, by_z = initialize_landmark(self._pose, seen)
            (mean,), (by_mean,) = translations(mean[None], np.array([seen.is_wall]), -centre[None])
            by_z, rows = by_mean @ by_z, slice(2 * j, 2 * j + 2)
            G[rows, :3] = by_mean @ by_pose
            if seen.sensor is not None:
                G[rows, self._at[Sensor]] = by_z @ seen.sensor.jacobian()
            noise.append(by_z @ seen.cov @ by_z.T)
            means.append(mean)
            centres.append(centre)
        cross = G @ self._cov[: self._head]
        own = plus_blocks(cross[:, : self._head] @ G.T, np.array(noise))
        self._cov = np.block([[self._cov, cross.T], [cross, 0.5 * (own + own.T)]])
        self._means, self._centres = np.vstack([self._means, *means]), np.vstack([self._centres, *centres])
        self._walls = np.concatenate([self._walls, [seen.is_wall for seen in observations.values()]])
        self._slots |= {i: len(self._slots) + j for j, i in enumerate(observations)}
