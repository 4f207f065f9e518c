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
from typing import Any

import gtsam
import numpy as np
from gtsam.symbol_shorthand import X

from sixthsense.config import ISAM2Config
from sixthsense.core.covariance import root_information
from sixthsense.core.geometry import Array, Pose, rotation, wrap_angle
from sixthsense.core.landmarks import Observation, line_errors, observed_centre
from sixthsense.core.motion import Odometry
from sixthsense.core.parameters import ParameterEstimate
from sixthsense.core.sensor import Sensor
from sixthsense.slam.estimators.base import LandmarkPrior, Link

Loss = gtsam.noiseModel.mEstimator.Base
_LOSS_SCALE = 1.5  # sigmas from which a match counts less: two of three right ones lie below

_FLOOR = 1e-6  # sigma (m, rad) added to each number: one that is known would make the system singular


def to_pose(pose: gtsam.Pose2) -> Pose:
    """Our pose of GTSAM's."""
    return Pose(pose.x(), pose.y(), pose.theta())


def to_pose2(pose: Pose) -> gtsam.Pose2:
    """GTSAM's pose of ours."""
    return gtsam.Pose2(pose.x, pose.y, pose.theta)


def gaussian(motion: Odometry) -> gtsam.noiseModel.Gaussian:
    """The noise of a motion, with a floor."""
    root = _roots(motion.cov[None])[0]
    return gtsam.noiseModel.Gaussian.SqrtInformation(root, False)


def _roots(covs: Array) -> Array:
    """(m, 3, 3) roots of the informations of motions with covariances (m, 3, 3), and a floor."""
    return root_information(covs + _FLOOR**2 * np.eye(3))


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
        return gtsam.noiseModel.mEstimator.Huber.Create(_LOSS_SCALE)
    if config.robust == "cauchy":
        return gtsam.noiseModel.mEstimator.Cauchy.Create(_LOSS_SCALE)
    return None


def with_loss(noise: gtsam.noiseModel.Gaussian, loss: Loss | None) -> gtsam.noiseModel.Base:
    """The noise, under a loss if there is one."""
    return noise if loss is None else gtsam.noiseModel.Robust.Create(loss, noise)


def link_factors(links: Sequence[Link]) -> list[gtsam.NonlinearFactor]:
    """The factors of links between the poses of their updates."""
    factors: list[gtsam.NonlinearFactor] = []
    for link, root in zip(links, _roots(np.array([link.relative.cov for link in links])), strict=True):
        noise: gtsam.noiseModel.Base = gtsam.noiseModel.Gaussian.SqrtInformation(root, False)
        if math.isfinite(link.loss_scale):
            noise = gtsam.noiseModel.Robust.Create(_cauchy(link.loss_scale), noise)
        motion = gtsam.Pose2(*link.relative.motion.triple())
        factors.append(gtsam.BetweenFactorPose2(X(link.before), X(link.after), motion, noise))
    return factors


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


WHEELS, SENSOR = int(gtsam.symbol("c", 0)), int(gtsam.symbol("s", 0))
"""keys of the variables, vectors"""


def parameters_factor(key: int, prior: ParameterEstimate[Any]) -> gtsam.NonlinearFactor:
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
        self._poses = poses
        self._jacobian = Pose(theta=motion.motion.theta).adjoint() @ motion.wheels.jacobian  # axes before the motion
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
        sensor = Sensor.from_array(values.atVector(SENSOR))
        theta = pose.theta()
        c, s = math.cos(theta), math.sin(theta)
        dx, dy = px - pose.x(), py - pose.y()
        x, y = c * dx + s * dy, c * dy - s * dx  # robot's frame
        seen = sensor.reported(np.array([x, y]))
        ahead, left = seen.tolist()
        distance = max(math.hypot(ahead, left), 1e-9)
        if jacobians is not None:
            by_seen = np.array([[-left / distance**2, ahead / distance**2], [ahead / distance, left / distance]])
            by_point = by_seen @ np.linalg.inv(sensor.corrected(seen)[1])
            jacobians[0] = by_point @ np.array([[-1.0, 0.0, y], [0.0, -1.0, -x]])
            jacobians[1] = by_point @ np.array([[c, s], [-s, c]])
            jacobians[2] = -by_point @ sensor.jacobian(seen)
        return np.array([wrap_angle(math.atan2(left, ahead) - self._bearing), distance - self._distance])


def graph_of(factor: gtsam.NonlinearFactor) -> gtsam.NonlinearFactorGraph:
    """The graph of one factor."""
    graph = gtsam.NonlinearFactorGraph()
    graph.add(factor)
    return graph


def prior_jacobians(prior: LandmarkPrior, frames: Array) -> list[Array]:
    """Jacobians by GTSAM's tangent of each landmark: of the whitened landmarks, then of each wall's shift along itself.

    `frames` (n, 3) are those of walls; of points they are unused.
    """
    n = len(prior.ids)
    root = root_information(floored(prior.cov))
    _, axes = lines(frames)
    along = np.cumsum(prior.walls) - 1 + 2 * n
    blocks = []
    for k, is_wall in enumerate(prior.walls.tolist()):
        block = np.zeros((2 * n + int(prior.walls.sum()), 3 if is_wall else 2))
        block[: 2 * n] = root[:, 2 * k : 2 * k + 2] @ axes[k] if is_wall else root[:, 2 * k : 2 * k + 2]
        if is_wall:
            block[along[k], 0] = 1.0 / FIRST_M  # the place of its origin along it is arbitrary
        blocks.append(block)
    return blocks


def prior_frames(prior: LandmarkPrior) -> Array:
    """(n, 3) frames of walls, whose origins are the middles of what was seen; of points they are unused."""
    alpha = prior.landmarks[:, 0]
    c, s = np.cos(alpha), np.sin(alpha)
    middle = prior.extents.mean(axis=1)
    off = prior.landmarks[:, 1] - (c * middle[:, 0] + s * middle[:, 1])
    return np.column_stack([middle[:, 0] + off * c, middle[:, 1] + off * s, wrap_angle(alpha - 0.5 * math.pi)])
