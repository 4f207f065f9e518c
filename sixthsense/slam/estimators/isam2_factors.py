"""GTSAM's poses, noise models and factors, made from ours.

A wall is a frame whose origin lies on it, x along it and y its normal. The origin's place along the wall is arbitrary;
the first observation fixes it. An observation measures the robot's distance from the wall and its heading against it: a
factor between two poses of GTSAM with a large sigma along the wall.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Sequence

import gtsam
import numpy as np
from gtsam.symbol_shorthand import X

from sixthsense.core.covariance import root_information
from sixthsense.core.geometry import Array, Pose, rotation, wrap_angle
from sixthsense.core.landmarks import Observation, line_errors, observed_centre
from sixthsense.core.motion import Odometry
from sixthsense.slam.estimators.base import Link

_FLOOR = 1e-6  # sigma (m, rad) added to each number: one that is known would make the system singular
# Sigma along the wall. The first observation fixes the origin: GTSAM's logarithm of a Pose2 couples tangential
# uncertainty into the normal residual, by half of the angle's residual.
_FIRST_M, _LATER_M = 1e-3, 1e3


def to_pose(pose: gtsam.Pose2) -> Pose:
    """Our pose of GTSAM's."""
    return Pose(pose.x(), pose.y(), pose.theta())


def to_pose2(pose: Pose) -> gtsam.Pose2:
    """GTSAM's pose of ours."""
    return gtsam.Pose2(pose.x, pose.y, pose.theta)


def floored(cov: Array) -> Array:
    """A covariance (..., n, n) with a floor that keeps the system regular."""
    return np.asarray(cov + _FLOOR**2 * np.eye(cov.shape[-1]))


def link_factors(links: Sequence[Link]) -> list[gtsam.NonlinearFactor]:
    """The factors of links between the poses of their updates."""
    factors: list[gtsam.NonlinearFactor] = []
    roots = root_information(floored(np.array([link.relative.cov for link in links])))
    for link, root in zip(links, roots, strict=True):
        noise: gtsam.noiseModel.Base = gtsam.noiseModel.Gaussian.SqrtInformation(root, False)
        if math.isfinite(link.loss_scale):
            noise = gtsam.noiseModel.Robust.Create(_cauchy(link.loss_scale), noise)
        motion = to_pose2(link.relative.motion)
        factors.append(gtsam.BetweenFactorPose2(X(link.before), X(link.after), motion, noise))
    return factors


@functools.lru_cache(maxsize=16)
def _cauchy(scale: float) -> gtsam.noiseModel.mEstimator.Base:
    """The loss of many links: there are two scales, and a loss has no state."""
    return gtsam.noiseModel.mEstimator.Cauchy.Create(scale)


def wall_frame(pose: Pose, observation: Observation) -> Pose:
    """The frame (`T_world_wall`) of a wall that is observed from `pose`: its origin is the middle of what was seen."""
    alpha = float(observation.z[0])
    middle = 0.5 * (observation.extent[0] + observation.extent[1])
    x, y = rotation(alpha) @ np.array([float(observation.z[1]), middle])
    return pose @ Pose(x, y, alpha - 0.5 * math.pi)


def measurement(pose: Pose, frame: Pose, observation: Observation, is_first: bool) -> tuple[Pose, Array]:
    """The robot's pose in the wall's frame, measured, and the square root of its information (3, 3), robot's axes.

    In the wall's frame y is the distance to the wall and the heading is its angle, for any prediction: nothing is
    linearized. In the robot's frame a turn of the wall would shift it by d/2 times the square of the turn. The errors
    of the observation are a turn about the centre of its returns and a shift there, which are independent. Of the
    predicted `pose` and `frame` only the centre's place along the wall is used.
    """
    x, y = observed_centre(observation)
    centre = Pose(x, y, float(observation.z[0]) - 0.5 * math.pi)  # axes of the wall
    along = (frame.inverse() @ pose @ centre).x
    _, of_turn, of_shift = line_errors(observation.cov)
    sigmas = np.array([_FIRST_M if is_first else _LATER_M, math.sqrt(of_shift), math.sqrt(of_turn)])
    # GTSAM's residual is in the axes of the measured pose; the logarithm of a motion changes by the adjoint.
    to_centre = centre.inverse()
    return Pose(x=along) @ to_centre, to_centre.adjoint() / sigmas[:, None]


def lines(frames: Array) -> tuple[Array, Array]:
    """(n, 2) walls (alpha, d) of frames (n, 3), and their Jacobians (n, 2, 3) by the frames, in each frame's axes."""
    alpha = wrap_angle(frames[:, 2] + 0.5 * math.pi)
    c, s = np.cos(alpha), np.sin(alpha)
    axes = np.zeros((len(frames), 2, 3))
    axes[:, 0, 2] = axes[:, 1, 1] = 1.0
    axes[:, 1, 2] = c * frames[:, 1] - s * frames[:, 0]  # the lever along the wall, from the origin's foot
    return np.column_stack([alpha, c * frames[:, 0] + s * frames[:, 1]]), axes


def wall_factor(
    wall: tuple[int, Pose], pose: tuple[int, Pose], observation: Observation, is_first: bool
) -> gtsam.NonlinearFactor:
    """The observation of a wall from a pose, each a key and its value."""
    place, root = measurement(pose[1], wall[1], observation, is_first)
    noise = gtsam.noiseModel.Gaussian.SqrtInformation(root)
    return gtsam.BetweenFactorPose2(wall[0], pose[0], to_pose2(place), noise)


def motion_factor(keys: Sequence[int], motion: Odometry) -> gtsam.NonlinearFactor:
    """The factor of odometry between the poses with two keys; with one key the prior of that pose."""
    # GTSAM factors the inverse of a covariance: where rounding has made that indefinite, the result is a constraint
    # that nothing has measured.
    noise = gtsam.noiseModel.Gaussian.SqrtInformation(root_information(floored(motion.cov)), False)
    if len(keys) == 1:
        return gtsam.PriorFactorPose2(keys[0], to_pose2(motion.motion), noise)
    return gtsam.BetweenFactorPose2(keys[0], keys[1], to_pose2(motion.motion), noise)


def point_factor(point: int, pose: int, observation: Observation) -> gtsam.NonlinearFactor:
    """The observation of a point as a factor between the variables with these keys."""
    bearing, distance, cov = observation.bearing_range()
    noise = gtsam.noiseModel.Gaussian.SqrtInformation(root_information(cov), False)
    return gtsam.BearingRangeFactor2D(pose, point, gtsam.Rot2(bearing), distance, noise)
