"""GTSAM's poses, noise models and factors, made from ours.

A wall is a frame whose origin lies on it, x along it and y its normal. The origin's place along the wall is arbitrary;
the first observation fixes it. An observation measures the robot's distance from the wall and its heading against it: a
factor between two poses of GTSAM with a large sigma along the wall.
"""

from __future__ import annotations

import functools
import math
from dataclasses import replace

import gtsam
import numpy as np

from sixthsense.config import ISAM2Config
from sixthsense.core.covariance import root_information
from sixthsense.core.geometry import Array, Pose, rotation, wrap_angle
from sixthsense.core.landmarks import Observation, line_errors, observed_centre
from sixthsense.core.motion import Odometry
from sixthsense.slam.estimators.base import Link

Loss = gtsam.noiseModel.mEstimator.Base

_FLOOR = 1e-6  # sigma (m, rad) added to each number: one that is known would make the system singular


def to_pose(pose: gtsam.Pose2) -> Pose:
    """Our pose of GTSAM's."""
    return Pose(pose.x(), pose.y(), pose.theta())


def to_pose2(pose: Pose) -> gtsam.Pose2:
    """GTSAM's pose of ours."""
    return gtsam.Pose2(pose.x, pose.y, pose.theta)


def gaussian(motion: Odometry) -> gtsam.noiseModel.Gaussian:
    """The noise of a motion, in the axes of the frame after, as GTSAM has it."""
    return noise_of(floored(motion.cov_after()))


def floored(cov: Array) -> Array:
    """A covariance (n, n) with a floor that keeps the system regular."""
    return np.asarray(cov + _FLOOR**2 * np.eye(len(cov)))


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


# Sigma along the wall. The first observation fixes the origin: GTSAM's logarithm of a Pose2 couples tangential
# uncertainty into the normal residual, by half of the angle's residual.
FIRST_M, _LATER_M = 1e-3, 1e3


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
    sigmas = np.array([FIRST_M if is_first else _LATER_M, math.sqrt(of_shift), math.sqrt(of_turn)])
    # GTSAM's residual is in the axes of the measured pose; the logarithm of a motion changes by the adjoint.
    to_centre = centre.inverse()
    return Pose(x=along) @ to_centre, to_centre.adjoint() / sigmas[:, None]


def stretch_factor(
    wall: tuple[int, Pose], key: int, pose: Pose, observation: Observation
) -> tuple[Pose, gtsam.NonlinearFactor]:
    """The frame of an apparent wall that is observed from `pose`, and its factor, with the key of the wall's variable.

    An apparent wall is the wall and an error of its shape. Its origin is where a turn and a shift by that error are
    independent.
    """
    assert observation.shape_cov is not None
    wall_key, frame = wall
    of_shape = replace(observation, cov=observation.shape_cov)
    x, y = observed_centre(of_shape)
    centre = Pose(x, y, float(observation.z[0]) - 0.5 * math.pi)
    place = Pose(x=(frame.inverse() @ pose @ centre).x)
    _, of_turn, of_shift = line_errors(observation.shape_cov)
    noise = gtsam.noiseModel.Diagonal.Sigmas(np.array([FIRST_M, math.sqrt(of_shift), math.sqrt(of_turn)]))
    return frame @ place, gtsam.BetweenFactorPose2(wall_key, key, to_pose2(place), noise)


def lines(frames: Array) -> tuple[Array, Array]:
    """(n, 2) walls (alpha, d) of frames (n, 3), and their Jacobians (n, 2, 3) by the frames, in each frame's axes."""
    alpha = wrap_angle(frames[:, 2] + 0.5 * math.pi)
    c, s = np.cos(alpha), np.sin(alpha)
    axes = np.zeros((len(frames), 2, 3))
    axes[:, 0, 2] = axes[:, 1, 1] = 1.0
    axes[:, 1, 2] = c * frames[:, 1] - s * frames[:, 0]  # the lever along the wall, from the origin's foot
    return np.column_stack([alpha, c * frames[:, 0] + s * frames[:, 1]]), axes


def wall_factor(
    wall: tuple[int, Pose], pose: tuple[int, Pose], observation: Observation, is_first: bool, loss: Loss | None
) -> gtsam.NonlinearFactor:
    """An observation as a factor between two poses of GTSAM, each a key and its value."""
    (key, frame), (at, guess) = wall, pose
    place, root = measurement(guess, frame, observation, is_first)
    noise = with_loss(gtsam.noiseModel.Gaussian.SqrtInformation(root), loss)
    return gtsam.BetweenFactorPose2(key, at, to_pose2(place), noise)


def exact_factor(wall: int, pose: int, observation: Observation, loss: Loss | None) -> gtsam.NonlinearFactor:
    """A later observation as a factor between the variables with these keys.

    GTSAM's factor between poses measures the place along the wall a little: its logarithm couples that with the angle's
    residual. Against the noise of odometry this is nothing, against wheels whose scale is unknown it is not.
    """
    _, of_turn, of_shift = line_errors(observation.cov)
    noise = with_loss(noise_of(np.diag([of_turn, of_shift])), loss)
    return gtsam.CustomFactor(noise, [wall, pose], Residual(wall, pose, observation))


class Residual:
    """Predicted less measured direction of a wall, and place of the centre of its returns; called by GTSAM.

    The two have independent errors.
    """

    def __init__(self, wall: int, pose: int, observation: Observation) -> None:
        """Between the variables with these keys."""
        self._wall, self._pose, self._alpha = wall, pose, float(observation.z[0])
        self._centre = observed_centre(observation)

    def __call__(self, _: gtsam.CustomFactor, values: gtsam.Values, jacobians: list[Array] | None) -> Array:
        """The residual (2,); fills `jacobians`, if there are any, in GTSAM's tangent of poses."""
        pose = values.atPose2(self._wall).between(values.atPose2(self._pose))  # in the wall's frame
        c, s = math.cos(pose.theta()), math.sin(pose.theta())
        x, y = rotation(pose.theta()) @ self._centre
        if jacobians is not None:
            jacobians[0] = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, pose.x() + x]])
            jacobians[1] = np.array([[0.0, 0.0, -1.0], [-s, -c, -x]])
        return np.array([wrap_angle(0.5 * math.pi - pose.theta() - self._alpha), -pose.y() - y])
