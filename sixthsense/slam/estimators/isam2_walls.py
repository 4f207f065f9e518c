"""Walls in a factor graph: a frame whose origin lies on the wall, x along it and y its normal.

The origin's place along the wall is arbitrary; the first sighting fixes it. A sighting measures the robot's distance
from the wall and its heading against it: a factor between two poses of GTSAM with a large sigma along the wall.
"""

from __future__ import annotations

import math

import gtsam
import numpy as np

from sixthsense.core.geometry import Array, Pose, rotation, wrap_angle
from sixthsense.core.landmarks import Sighting
from sixthsense.slam.estimators.isam2_factors import Loss, noise_of, to_pose2, with_loss

# Sigma along the wall. The first sighting fixes the origin: GTSAM's logarithm of a Pose2 couples tangential uncertainty
# into the normal residual, by half of the angle's residual.
_FIRST_M, _LATER_M = 1e-3, 1e3


def wall_frame(pose: Pose, sighting: Sighting) -> Pose:
    """The frame (`T_world_wall`) of a wall that is sighted from `pose`: its origin is the middle of what was seen."""
    alpha = float(sighting.z[0])
    middle = 0.5 * (sighting.extent[0] + sighting.extent[1])
    x, y = rotation(alpha) @ np.array([float(sighting.z[1]), middle])
    return pose @ Pose(x, y, alpha - 0.5 * math.pi)


def measurement(pose: Pose, frame: Pose, sighting: Sighting, is_first: bool) -> tuple[Pose, Array]:
    """A sighting as the robot's pose in the wall's frame, and the square root of its information (3, 3), robot's axes.

    In the wall's frame y is the distance to the wall and the heading is its angle, for any prediction: nothing is
    linearized. In the robot's frame a turn of the wall would shift it by d/2 times the square of the turn. Of the
    predicted `pose` and `frame` only the robot's place along the wall is used.
    """
    along = (frame.inverse() @ pose).x
    measured = Pose(along, -float(sighting.z[1]), 0.5 * math.pi - float(sighting.z[0]))
    # In the wall's axes the errors of (y, theta) are minus those of (d, alpha).
    root = np.zeros((3, 3))
    root[0, 0] = 1.0 / (_FIRST_M if is_first else _LATER_M)
    root[1:, 1:] = np.linalg.cholesky(np.linalg.inv(sighting.cov[::-1, ::-1])).T
    root[:, :2] = root[:, :2] @ rotation(measured.theta)  # GTSAM's residual is in the measured pose's own axes
    return measured, root


def lines(frames: Array) -> tuple[Array, Array]:
    """(n, 2) walls (alpha, d) of frames (n, 3), and their Jacobians (n, 2, 3) by the frames, in each frame's axes."""
    alpha = wrap_angle(frames[:, 2] + 0.5 * math.pi)
    c, s = np.cos(alpha), np.sin(alpha)
    axes = np.zeros((len(frames), 2, 3))
    axes[:, 0, 2] = axes[:, 1, 1] = 1.0
    axes[:, 1, 2] = c * frames[:, 1] - s * frames[:, 0]  # the lever along the wall, from the origin's foot
    return np.column_stack([alpha, c * frames[:, 0] + s * frames[:, 1]]), axes


def wall_factor(
    wall: tuple[int, Pose], pose: tuple[int, Pose], sighting: Sighting, is_first: bool, loss: Loss | None
) -> gtsam.NonlinearFactor:
    """A sighting as a factor between two poses of GTSAM, each a key and its value."""
    (key, frame), (at, guess) = wall, pose
    place, root = measurement(guess, frame, sighting, is_first)
    noise = with_loss(gtsam.noiseModel.Gaussian.SqrtInformation(root), loss)
    return gtsam.BetweenFactorPose2(key, at, to_pose2(place), noise)


def exact_factor(wall: int, pose: int, sighting: Sighting, loss: Loss | None) -> gtsam.NonlinearFactor:
    """A later sighting as a factor between the variables with these keys.

    GTSAM's factor between poses measures the place along the wall a little: its logarithm couples that with the angle's
    residual. Against the noise of odometry this is nothing, against wheels whose scale is unknown it is not.
    """
    return gtsam.CustomFactor(with_loss(noise_of(sighting.cov), loss), [wall, pose], Residual(wall, pose, sighting))


class Residual:
    """Predicted less measured (alpha, d) of a wall's sighting, with its Jacobians; called by GTSAM."""

    def __init__(self, wall: int, pose: int, sighting: Sighting) -> None:
        """Between the variables with these keys."""
        self._wall, self._pose = wall, pose
        self._alpha, self._distance = (float(value) for value in sighting.z)

    def __call__(self, _: gtsam.CustomFactor, values: gtsam.Values, jacobians: list[Array] | None) -> Array:
        """The residual (2,); fills `jacobians`, if there are any, in GTSAM's tangent of poses."""
        pose = values.atPose2(self._wall).between(values.atPose2(self._pose))  # in the wall's frame
        x, y, theta = pose.x(), pose.y(), pose.theta()
        if jacobians is not None:
            jacobians[0] = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, x]])
            jacobians[1] = np.array([[0.0, 0.0, -1.0], [-math.sin(theta), -math.cos(theta), 0.0]])
        return np.array([wrap_angle(0.5 * math.pi - theta - self._alpha), -y - self._distance])
