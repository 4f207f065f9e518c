"""GTSAM's poses, noise models and factors, made from ours."""

from __future__ import annotations

import functools
import math

import gtsam
import numpy as np

from sixthsense.config import ISAM2Config
from sixthsense.core.covariance import root_information
from sixthsense.core.geometry import Array, Pose
from sixthsense.core.motion import Odometry
from sixthsense.slam.estimators.base import Link

Loss = gtsam.noiseModel.mEstimator.Base

_FLOOR = 1e-6  # smallest sigma (m, rad) of a pose's factor: a certain motion or start would make the system singular
_FLOOR_COV = _FLOOR**2 * np.eye(3)


def to_pose(pose: gtsam.Pose2) -> Pose:
    """Our pose of GTSAM's."""
    return Pose(pose.x(), pose.y(), pose.theta())


def to_pose2(pose: Pose) -> gtsam.Pose2:
    """GTSAM's pose of ours."""
    return gtsam.Pose2(pose.x, pose.y, pose.theta)


def gaussian(motion: Odometry) -> gtsam.noiseModel.Gaussian:
    """The noise of a motion, in the axes of the frame after, as GTSAM has it."""
    return noise_of(motion.cov_after() + _FLOOR_COV)


def noise_of(cov: Array) -> gtsam.noiseModel.Gaussian:
    """The noise with a covariance (n, n).

    GTSAM itself factors the inverse of a covariance: where rounding has made that indefinite, the result is a
    constraint that nothing has measured.
    """
    return gtsam.noiseModel.Gaussian.SqrtInformation(root_information(cov), False)


def loss_of(config: ISAM2Config) -> Loss | None:
    """The configured loss on landmarks' factors; None for squares."""
    if config.robust == "huber":
        return gtsam.noiseModel.mEstimator.Huber.Create(config.robust_scale)
    if config.robust == "cauchy":
        return gtsam.noiseModel.mEstimator.Cauchy.Create(config.robust_scale)
    return None


def with_loss(noise: gtsam.noiseModel.Gaussian, loss: Loss | None) -> gtsam.noiseModel.Base:
    """The noise, under a loss if there is one."""
    return noise if loss is None else gtsam.noiseModel.Robust.Create(loss, noise)


def link_factor(before: int, after: int, link: Link) -> gtsam.NonlinearFactor:
    """The factor of a link between the variables with these keys."""
    noise: gtsam.noiseModel.Base = gaussian(link.relative)
    if math.isfinite(link.loss_scale):
        noise = gtsam.noiseModel.Robust.Create(_cauchy(link.loss_scale), noise)
    return gtsam.BetweenFactorPose2(before, after, to_pose2(link.relative.motion), noise)


@functools.lru_cache(maxsize=16)
def _cauchy(scale: float) -> gtsam.noiseModel.mEstimator.Base:
    """The loss of many links: there are two scales, and a loss has no state."""
    return gtsam.noiseModel.mEstimator.Cauchy.Create(scale)
