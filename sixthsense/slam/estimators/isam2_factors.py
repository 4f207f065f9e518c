"""GTSAM's poses, noise models and factors, made from ours.

A wall is a frame whose origin lies on it, x along it and y its normal. The origin's place along the wall is arbitrary;
the first observation fixes it. An observation measures the robot's distance from the wall and its heading against it: a
factor between two poses of GTSAM with a large sigma along the wall.

Parameters of wheels and sensor are a variable that all odometry, or all points, depend on. GTSAM has no factor whose
measurement depends on one variable more. Its residual is therefore computed here; GTSAM calls it at each linearization.
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
from sixthsense.core.sensor import Sensor
from sixthsense.slam.estimators.base import LandmarkPrior, Link

WHEELS, SENSOR = int(gtsam.symbol("c", 0)), int(gtsam.symbol("s", 0))
"""keys of the parameters, vectors"""
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


def noise_of(cov: Array) -> gtsam.noiseModel.Gaussian:
    """The noise with a covariance (n, n).

    GTSAM itself factors the inverse of a covariance: where rounding has made that indefinite, the result is a
    constraint that nothing has measured.
    """
    return gtsam.noiseModel.Gaussian.SqrtInformation(root_information(cov), False)


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
    wall: tuple[int, Pose], pose: tuple[int, Pose], observation: Observation, is_first: bool, is_exact: bool
) -> gtsam.NonlinearFactor:
    """The observation of a wall from a pose, each a key and its value.

    GTSAM's factor between poses measures the place along the wall a little: its logarithm couples that with the angle's
    residual. Against the noise of odometry this is nothing, against wheels whose scale is unknown it is not: `is_exact`
    makes later observations factors of their own.
    """
    if is_exact and not is_first:
        _, of_turn, of_shift = line_errors(observation.cov)
        residual = _WallResidual(wall[0], pose[0], observation)
        return gtsam.CustomFactor(noise_of(np.diag([of_turn, of_shift])), [wall[0], pose[0]], residual)
    place, root = measurement(pose[1], wall[1], observation, is_first)
    noise = gtsam.noiseModel.Gaussian.SqrtInformation(root)
    return gtsam.BetweenFactorPose2(wall[0], pose[0], to_pose2(place), noise)


class _WallResidual:
    """Predicted less measured direction of a wall, and place of the centre of its returns; called by GTSAM."""

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


def motion_factor(keys: Sequence[int], motion: Odometry, has_wheels: bool) -> gtsam.NonlinearFactor:
    """The factor of odometry between the poses with two keys, and the wheels if they are a variable.

    With one key it is the prior of that pose, and `motion` its odometry from the origin.
    """
    noise = gtsam.noiseModel.Gaussian.SqrtInformation(root_information(floored(motion.cov)), False)
    if motion.wheels is not None and has_wheels:
        return gtsam.CustomFactor(noise, [*keys, WHEELS], _MotionResidual(keys, motion))
    if len(keys) == 1:
        return gtsam.PriorFactorPose2(keys[0], to_pose2(motion.motion), noise)
    return gtsam.BetweenFactorPose2(keys[0], keys[1], to_pose2(motion.motion), noise)


class _MotionResidual:
    """Predicted less measured motion, axes of the measured frame after, with its Jacobians.

    The measured motion is linear in the parameters. Of two poses the motion is that between them; of one, the pose.
    """

    def __init__(self, poses: Sequence[int], motion: Odometry) -> None:
        """Between the poses with these keys; `motion` depends on the wheels."""
        assert motion.wheels is not None
        self._poses = poses
        self._jacobian = Pose(theta=motion.motion.theta).adjoint() @ motion.wheels.jacobian  # axes before the motion
        self._motion_at_zero = motion.motion.array() - self._jacobian @ motion.wheels.values.array()

    def __call__(self, _: gtsam.CustomFactor, values: gtsam.Values, jacobians: list[Array] | None) -> Array:
        """The residual (3,); fills `jacobians`, if there are any, in GTSAM's tangent of poses."""
        poses = [values.atPose2(key) for key in self._poses]
        found = poses[0].between(poses[1]) if len(poses) == 2 else poses[0]
        x, y = found.x(), found.y()
        mx, my, turn = (self._motion_at_zero + self._jacobian @ values.atVector(WHEELS)).tolist()
        c, s = math.cos(turn), math.sin(turn)
        right, up = c * (x - mx) + s * (y - my), c * (y - my) - s * (x - mx)
        off = wrap_angle(found.theta() - turn)
        if jacobians is not None:
            if len(poses) == 2:  # by a small motion of the pose before, in its axes
                jacobians[0] = np.array([[-c, -s, c * y - s * x], [s, -c, -s * y - c * x], [0.0, 0.0, -1.0]])
            jacobians[-2] = Pose(theta=off).adjoint()
            jacobians[-1] = np.array([[-c, -s, up], [s, -c, -right], [0.0, 0.0, -1.0]]) @ self._jacobian
        return np.array([right, up, off])


def point_factor(point: int, pose: int, observation: Observation, sensor: Sensor | None) -> gtsam.NonlinearFactor:
    """The observation of a point as a factor between the variables with these keys, and the sensor if it is one."""
    if sensor is None:
        bearing, distance, cov = observation.bearing_range()
        return gtsam.BearingRangeFactor2D(pose, point, gtsam.Rot2(bearing), distance, noise_of(cov))
    terms = observation.with_sensor(sensor).sensor
    assert terms is not None
    bearing, distance, cov = Observation(observation.kind, terms.z, terms.cov).bearing_range()
    residual = _PointResidual((pose, point), bearing, distance)
    return gtsam.CustomFactor(noise_of(cov), [pose, point, SENSOR], residual)


class _PointResidual:
    """Predicted less reported bearing and distance, with its Jacobians; called by GTSAM."""

    def __init__(self, keys: tuple[int, int], bearing: float, distance: float) -> None:
        """Of the point with the second key, seen from the pose with the first one."""
        (self._pose, self._point), self._bearing, self._distance = keys, bearing, distance

    def __call__(self, _: gtsam.CustomFactor, values: gtsam.Values, jacobians: list[Array] | None) -> Array:
        """The residual (2,); fills `jacobians`, if there are any, in GTSAM's tangent of poses."""
        pose, sensor = to_pose(values.atPose2(self._pose)), Sensor.from_array(values.atVector(SENSOR))
        to_robot = rotation(pose.theta).T
        x, y = to_robot @ (values.atPoint2(self._point) - pose.position)
        seen = sensor.reported(np.array([x, y]))
        ahead, left = seen.tolist()
        distance = max(math.hypot(ahead, left), 1e-9)
        if jacobians is not None:
            by_seen = np.array([[-left / distance**2, ahead / distance**2], [ahead / distance, left / distance]])
            by_point = by_seen @ np.linalg.inv(sensor.corrected(seen)[1])
            jacobians[0] = by_point @ np.array([[-1.0, 0.0, y], [0.0, -1.0, -x]])
            jacobians[1] = by_point @ to_robot
            jacobians[2] = -by_point @ sensor.jacobian(seen)
        return np.array([wrap_angle(math.atan2(left, ahead) - self._bearing), distance - self._distance])


def prior_factors(prior: LandmarkPrior, keys: Sequence[int], values: gtsam.Values) -> list[gtsam.NonlinearFactor]:
    """The joint Gaussian of earlier landmarks about their `values`, and the arbitrary place of each wall's origin.

    As a quadratic form it is eliminated in a third of the time that rows for all numbers of the landmarks take.
    """
    root, blocks, factors = root_information(floored(prior.cov)), [], []
    loose = gtsam.noiseModel.Diagonal.Sigmas(np.array([_FIRST_M, _LATER_M, _LATER_M]))
    for k, (key, is_wall) in enumerate(zip(keys, prior.walls.tolist(), strict=True)):
        block = root[:, 2 * k : 2 * k + 2]
        if is_wall:
            frame = values.atPose2(key)
            factors.append(gtsam.PriorFactorPose2(key, frame, loose))
            block = block @ lines(to_pose(frame).array()[None])[1][0]
        blocks.append(block)

    def whitened(_: gtsam.CustomFactor, values: gtsam.Values, jacobians: list[Array] | None) -> Array:
        if jacobians is not None:
            for k, block in enumerate(blocks):
                jacobians[k] = block
        return np.zeros(len(root))  # the landmarks are at their means

    exact = gtsam.CustomFactor(gtsam.noiseModel.Unit.Create(len(root)), list(keys), whitened).linearize(values)
    return [*factors, gtsam.LinearContainerFactor(gtsam.HessianFactor(exact), values)]


def prior_frame(landmark: Array, extent: Array) -> Pose:
    """The frame of a wall (2,) of an earlier run, whose origin is the middle of what was seen of it (2, 2)."""
    normal, middle = rotation(float(landmark[0]))[:, 0], extent.mean(axis=0)
    x, y = middle + (float(landmark[1]) - normal @ middle) * normal
    return Pose(x, y, float(landmark[0]) - 0.5 * math.pi)
