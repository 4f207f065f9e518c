"""The wheels' parameters in a factor graph: one variable that all odometry depends on.

GTSAM has no factor between two poses whose measurement depends on a third variable. Its residual is therefore computed
here, called by GTSAM at each linearization.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import gtsam
import numpy as np

from sixthsense.core.geometry import Array, wrap_angle
from sixthsense.core.motion import Odometry
from sixthsense.core.wheels import PARAMETERS, WheelEstimate
from sixthsense.slam.estimators.isam2_factors import gaussian, noise_of, to_pose2

KEY = int(gtsam.symbol("c", 0))
"""of the variable, a vector"""
_FLOOR = 1e-6  # sigma added to each parameter: one that is known would make the system singular


def prior_factor(prior: WheelEstimate) -> gtsam.NonlinearFactor:
    """The prior of the parameters."""
    noise = noise_of(prior.cov + _FLOOR**2 * np.eye(PARAMETERS))
    return gtsam.PriorFactorVector(KEY, prior.values.array(), noise)


def motion_factor(before: int, after: int, motion: Odometry, with_wheels: bool) -> gtsam.NonlinearFactor:
    """The factor of odometry between the poses with these keys, and the wheels if they are a variable."""
    noise = gaussian(motion)
    if motion.wheels is None or not with_wheels:
        return gtsam.BetweenFactorPose2(before, after, to_pose2(motion.motion), noise)
    return gtsam.CustomFactor(noise, [before, after, KEY], Residual((before, after), motion))


def start_factor(key: int, pose: Odometry, with_wheels: bool) -> gtsam.NonlinearFactor:
    """The prior of the first pose, and the wheels if they are a variable; `pose` is its odometry from the origin."""
    noise = gaussian(pose)
    if pose.wheels is None or not with_wheels:
        return gtsam.PriorFactorPose2(key, to_pose2(pose.motion), noise)
    return gtsam.CustomFactor(noise, [key, KEY], Residual((key,), pose))


class Residual:
    """Predicted less measured motion, axes of the measured frame after, with its Jacobians.

    The measured motion is linear in the parameters. Of two poses the motion is that between them; of one, the pose.
    """

    def __init__(self, poses: tuple[int, ...], motion: Odometry) -> None:
        """Between the poses with these keys; `motion` depends on the wheels."""
        assert motion.wheels is not None
        self._poses, self._jacobian = poses, motion.wheels.jacobian
        self._motion_at_zero = motion.motion.array() - self._jacobian @ motion.wheels.values.array()

    def __call__(self, _: gtsam.CustomFactor, values: gtsam.Values, jacobians: list[Array] | None) -> Array:
        """The residual (3,); fills `jacobians`, if there are any, in GTSAM's tangent of poses."""
        poses = [values.atPose2(key) for key in self._poses]
        found = poses[0].between(poses[1]) if len(poses) == 2 else poses[0]
        x, y, theta = found.x(), found.y(), found.theta()
        of_wheels = self._jacobian @ values.atVector(KEY)
        mx, my, turn = (self._motion_at_zero + of_wheels).tolist()
        c, s = math.cos(turn), math.sin(turn)
        right, up = c * (x - mx) + s * (y - my), c * (y - my) - s * (x - mx)
        if jacobians is not None:
            self._fill(jacobians, (c, s), (x, y, theta - turn), (right, up))
        return np.array([right, up, wrap_angle(theta - turn)])

    def _fill(
        self, jacobians: list[Array], axes: tuple[float, float], found: Sequence[float], off: tuple[float, float]
    ) -> None:
        (c, s), (x, y, turn) = axes, found
        if len(self._poses) == 2:
            # By a small motion of the pose before, in its axes.
            jacobians[0] = np.array([[-c, -s, c * y - s * x], [s, -c, -s * y - c * x], [0.0, 0.0, -1.0]])
        ct, st = math.cos(turn), math.sin(turn)
        jacobians[-2] = np.array([[ct, -st, 0.0], [st, ct, 0.0], [0.0, 0.0, 1.0]])
        by_motion = np.array([[-c, -s, off[1]], [s, -c, -off[0]], [0.0, 0.0, -1.0]])
        jacobians[-1] = by_motion @ self._jacobian
