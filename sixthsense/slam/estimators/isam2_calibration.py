"""Parameters of wheels and sensor in a factor graph: a variable that all odometry, or all points, depend on.

GTSAM has no factor whose measurement depends on one variable more. Its residual is therefore computed here, called by
GTSAM at each linearization.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import gtsam
import numpy as np

from sixthsense.core.geometry import Array, wrap_angle
from sixthsense.core.landmarks import Observation
from sixthsense.core.motion import Odometry
from sixthsense.core.sensor import Sensor, SensorEstimate
from sixthsense.core.wheels import WheelEstimate
from sixthsense.slam.estimators.isam2_factors import Loss, floored, gaussian, noise_of, to_pose2, with_loss

WHEELS, SENSOR = int(gtsam.symbol("c", 0)), int(gtsam.symbol("s", 0))
"""keys of the variables, vectors"""


def parameters_factor(key: int, prior: WheelEstimate | SensorEstimate) -> gtsam.NonlinearFactor:
    """The prior of the parameters in a variable."""
    return gtsam.PriorFactorVector(key, prior.values.array(), noise_of(floored(prior.cov)))


def motion_factor(before: int, after: int, motion: Odometry, with_wheels: bool) -> gtsam.NonlinearFactor:
    """The factor of odometry between the poses with these keys, and the wheels if they are a variable."""
    noise = gaussian(motion)
    if motion.wheels is None or not with_wheels:
        return gtsam.BetweenFactorPose2(before, after, to_pose2(motion.motion), noise)
    return gtsam.CustomFactor(noise, [before, after, WHEELS], _MotionResidual((before, after), motion))


def start_factor(key: int, pose: Odometry, with_wheels: bool) -> gtsam.NonlinearFactor:
    """The prior of the first pose, and the wheels if they are a variable; `pose` is its odometry from the origin."""
    noise = gaussian(pose)
    if pose.wheels is None or not with_wheels:
        return gtsam.PriorFactorPose2(key, to_pose2(pose.motion), noise)
    return gtsam.CustomFactor(noise, [key, WHEELS], _MotionResidual((key,), pose))


class _MotionResidual:
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
        of_wheels = self._jacobian @ values.atVector(WHEELS)
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


def seen_point(
    point: int, pose: int, observation: Observation, sensor: Sensor | None, loss: Loss | None
) -> gtsam.NonlinearFactor:
    """The observation of a point as a factor between the variables with these keys, and those of the sensor if any."""
    if sensor is None:
        bearing, distance, cov = observation.bearing_range()
        return gtsam.BearingRangeFactor2D(pose, point, gtsam.Rot2(bearing), distance, with_loss(noise_of(cov), loss))
    terms = observation.with_sensor(sensor).sensor
    assert terms is not None
    bearing, distance, cov = Observation(observation.kind, terms.z, terms.cov).bearing_range()
    residual = _PointResidual((pose, point), bearing, distance)
    return gtsam.CustomFactor(with_loss(noise_of(cov), loss), [pose, point, SENSOR], residual)


class _PointResidual:
    """Predicted less reported bearing and distance, with its Jacobians; called by GTSAM."""

    def __init__(self, keys: tuple[int, int], bearing: float, distance: float) -> None:
        """Of the point with the second key, seen from the pose with the first one."""
        (self._pose, self._point), self._bearing, self._distance = keys, bearing, distance

    def __call__(self, _: gtsam.CustomFactor, values: gtsam.Values, jacobians: list[Array] | None) -> Array:
        """The residual (2,); fills `jacobians`, if there are any, in GTSAM's tangent of poses."""
        pose, (px, py) = values.atPose2(self._pose), values.atPoint2(self._point)
        yaw, forward, scale_error = values.atVector(SENSOR)
        theta = pose.theta()
        c, s = math.cos(theta), math.sin(theta)
        dx, dy = px - pose.x(), py - pose.y()
        x, y = c * dx + s * dy, c * dy - s * dx  # robot's frame
        off = x - forward
        distance, scale = max(math.hypot(off, y), 1e-9), 1.0 + scale_error
        bearing = wrap_angle(math.atan2(y, off) - yaw) / scale
        if jacobians is not None:
            along = np.array([off, y]) / distance
            by_point = np.array([[-along[1] / (distance * scale), along[0] / (distance * scale)], along])
            jacobians[0] = by_point @ np.array([[-1.0, 0.0, y], [0.0, -1.0, -x]])
            jacobians[1] = by_point @ np.array([[c, s], [-s, c]])
            jacobians[2] = np.column_stack([(-1.0 / scale, 0.0), -by_point[:, 0], (-bearing / scale, 0.0)])
        return np.array([wrap_angle(bearing - self._bearing), distance - self._distance])
