"""Batch least squares over all poses and landmarks: the reference of the laws of the posterior.

It shares no code with the estimators. The observation models are written from geometry alone, Jacobians are central
differences, and the information matrix of all variables is dense.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sixthsense.core.geometry import Array, Pose, wrap_angle
from sixthsense.core.landmarks import LandmarkId, Observation
from sixthsense.core.motion import Odometry
from sixthsense.core.parameters import ParameterEstimate
from sixthsense.core.se2 import between, compose, move_covariance
from sixthsense.core.wheels import PARAMETERS, Wheels

Log = Sequence[tuple[Odometry, Mapping[LandmarkId, Observation]]]
Residual = Callable[[Array], Array]
Places = NDArray[np.intp]

_STEP = 1e-5  # of central differences, m and rad
_ITERATIONS = 6


@dataclass(frozen=True, slots=True)
class Posterior:
    """Mean and joint covariance of the last pose, of all landmarks, world frame, and of the wheels' parameters."""

    ids: list[LandmarkId]
    """in the order of the first observation"""
    mean: Array
    """(3 + 2n,) x, y, theta, then the two numbers of each landmark; m, rad; the parameters of wheels if they are
    estimated"""
    cov: Array
    """of the entries of `mean`"""
    angles: NDArray[np.bool_]
    """which entries of `mean` are angles: the heading and the angles of walls"""


@dataclass(frozen=True, slots=True)
class _Factor:
    """One term of the sum of squares."""

    at: Places
    """of its variables among all"""
    residual: Residual
    """of these variables, m and rad"""
    cov: Array
    """covariance of the residual"""


def to_robot(pose: Array, landmark: Array, is_wall: bool) -> Array:
    """The observation (2,) of a landmark (2,) from a pose (3,): of a wall by two points on it."""
    c, s = math.cos(pose[2]), math.sin(pose[2])
    world_to_robot = np.array([[c, s], [-s, c]])
    if not is_wall:
        return np.asarray(world_to_robot @ (landmark - pose[:2]))
    return _line(world_to_robot @ (_two_points(landmark) - pose[:2]).T)


def to_world(pose: Array, z: Array, is_wall: bool) -> Array:
    """The landmark (2,) that is observed at z (2,) from a pose (3,): the inverse of `to_robot`."""
    c, s = math.cos(pose[2]), math.sin(pose[2])
    robot_to_world = np.array([[c, -s], [s, c]])
    if not is_wall:
        return np.asarray(pose[:2] + robot_to_world @ z)
    return _line(robot_to_world @ _two_points(z).T + pose[:2, None])


def jacobian(function: Residual, x: Array) -> Array:
    """(m, n) Jacobian by central differences of a function whose values are small or do not wrap."""
    columns = [(function(x + h) - function(x - h)) / (2.0 * _STEP) for h in _STEP * np.eye(len(x))]
    return np.column_stack(columns)


def observation_jacobian(pose: Array, landmark: Array, is_wall: bool) -> Array:
    """(2, 5) Jacobian of an observation by the pose, then by the landmark."""
    z = to_robot(pose, landmark, is_wall)
    return jacobian(lambda x: _difference(to_robot(x[:3], x[3:], is_wall), z, is_wall), np.append(pose, landmark))


def batch_posterior(
    log: Log, start: Pose, start_cov: Array, wheels: ParameterEstimate[Wheels] | None = None
) -> Posterior:
    """The posterior of a log by Gauss-Newton iterations from dead reckoning and the first observations.

    `start_cov` (3, 3) and the covariances of odometry must be invertible. With a prior of `wheels` their parameters are
    estimated, too.
    """
    poses, landmarks, walls = _initial(log, start)
    of_wheels = [] if wheels is None else [wheels.values.array()]
    x = np.concatenate([*poses, *landmarks.values(), *of_wheels])
    of_landmarks = {i: 3 * len(poses) + 2 * k + np.arange(2) for k, i in enumerate(landmarks)}
    factors = _factors(log, of_landmarks, wheels)
    start_cov = move_covariance((0.0, 0.0, -start.theta), start_cov)
    factors.append(_Factor(np.arange(3), lambda x: between(start.array(), x), start_cov))
    for _ in range(_ITERATIONS):
        information, gradient = np.zeros((len(x), len(x))), np.zeros(len(x))
        for factor in factors:
            at, weight = factor.at, np.linalg.inv(factor.cov)
            r, J = factor.residual(x[at]), jacobian(factor.residual, x[at])
            information[np.ix_(at, at)] += J.T @ weight @ J
            gradient[at] += J.T @ weight @ r
        shift = np.linalg.solve(information, -gradient)
        x = x + shift
        if np.abs(shift).max() < 1e-11:
            break
    kept = np.arange(3 * len(poses) - 3, len(x))
    flags = [False, False, True, *(flag for i in landmarks for flag in (walls[i], False))]
    angles = np.array([*flags, *[False] * (PARAMETERS * len(of_wheels))])
    cov = np.linalg.inv(information)[np.ix_(kept, kept)]
    return Posterior(list(landmarks), x[kept], 0.5 * (cov + cov.T), angles)


def _initial(log: Log, start: Pose) -> tuple[list[Array], dict[LandmarkId, Array], dict[LandmarkId, bool]]:
    """Poses by dead reckoning, the start first; landmarks at their first observation; which of them are walls."""
    poses, landmarks, walls = [start.array()], {}, {}
    for odometry, observations in log:
        poses.append((Pose.from_array(poses[-1]) @ odometry.motion).array())
        for i, observation in observations.items():
            if i not in landmarks:
                landmarks[i] = to_world(poses[-1], observation.z, observation.is_wall)
                walls[i] = observation.is_wall
    return poses, landmarks, walls


def _factors(
    log: Log, of_landmarks: Mapping[LandmarkId, Places], wheels: ParameterEstimate[Wheels] | None
) -> list[_Factor]:
    """Odometry, observations, and the prior of the wheels."""
    factors = []
    of_wheels = 3 * len(log) + 3 + 2 * len(of_landmarks) + np.arange(PARAMETERS if wheels is not None else 0)
    if wheels is not None:
        mean = wheels.values.array()
        factors.append(_Factor(of_wheels, lambda x: x - mean, wheels.cov))
    for k, (odometry, observations) in enumerate(log):
        before, after = 3 * k + np.arange(3), 3 * k + 3 + np.arange(3)
        at = np.concatenate([before, after, of_wheels])
        factors.append(_Factor(at, _motion_residual(odometry), odometry.cov))
        for i, observation in observations.items():
            at = np.append(after, of_landmarks[i])
            factors.append(_Factor(at, _observation_residual(observation), observation.cov))
    return factors


def _motion_residual(odometry: Odometry) -> Residual:
    """Of two poses, and the wheels' parameters if they are variables."""

    def residual(x: Array) -> Array:
        measured = odometry.motion.array()
        if len(x) > 6 and odometry.wheels is not None:
            measured = compose(measured, odometry.wheels.jacobian @ (x[6:] - odometry.wheels.values.array()))
        return between(measured, between(x[:3], x[3:6]))

    return residual


def _observation_residual(observation: Observation) -> Residual:
    def residual(x: Array) -> Array:
        return _difference(to_robot(x[:3], x[3:], observation.is_wall), observation.z, observation.is_wall)

    return residual


def _difference(one: Array, two: Array, is_wall: bool) -> Array:
    gap = one - two
    return np.array([wrap_angle(float(gap[0])), gap[1]]) if is_wall else gap


def _two_points(wall: Array) -> Array:
    """(2, 2) two points on the wall (alpha, d), 1 m apart, the second to the left of the normal."""
    normal = np.array([math.cos(wall[0]), math.sin(wall[0])])
    foot = wall[1] * normal
    return np.stack([foot, foot + np.array([-normal[1], normal[0]])])


def _line(points: Array) -> Array:
    """(alpha, d) of the line through two points, the columns of `points` (2, 2)."""
    along = points[:, 1] - points[:, 0]
    normal = np.array([along[1], -along[0]])
    return np.array([math.atan2(normal[1], normal[0]), float(normal @ points[:, 0])])
