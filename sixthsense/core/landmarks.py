"""Landmarks and their observations: parameters, predicted observations and initialization, with Jacobians."""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from sixthsense.core.geometry import Array, Pose, rotation, wrap_angle
from sixthsense.core.landmark_kernels import line_ends, predictions
from sixthsense.core.sensor import Sensor, SensorTerms

LandmarkId = int


class Kind(enum.IntEnum):
    """Kind of a landmark: a point (x, y), or a wall, a line (alpha, d) with the points x cos alpha + y sin alpha = d.

    Corners and free ends may be matched with each other, points and walls may not. A wall's normal points to the side
    it was seen from, so that the two sides of a thin wall are two landmarks.
    """

    CORNER = 0
    """Where two walls meet."""
    END = 1
    """Where a wall ends."""
    WALL = 2
    """A straight wall; the associator keeps its extent."""


@dataclass(frozen=True, slots=True)
class Observation:
    """One landmark as one scan saw it."""

    kind: Kind
    z: Array
    """(2,) in the robot's frame: position, m (report eq. 5); of a wall alpha, rad, and d, m"""
    cov: Array
    """(2, 2) of z"""
    extent: tuple[float, float] = (0.0, 0.0)
    """of a wall: first and last place that was seen, m along (-sin alpha, cos alpha) from the robot"""
    sensor: SensorTerms | None = field(default=None, repr=False, compare=False)
    """its dependence on the sensor's parameters, if these are estimated; not recorded"""

    @property
    def is_wall(self) -> bool:
        """Whether z is a line."""
        return self.kind == Kind.WALL

    def with_sensor(self, values: Sensor) -> Observation:
        """The same observation of a point for other parameters of the sensor; of a wall, the observation itself."""
        if self.is_wall or (self.sensor is not None and self.sensor.values == values):
            return self
        z, cov = (self.z, self.cov) if self.sensor is None else (self.sensor.z, self.sensor.cov)
        corrected, by_z = values.corrected(z)
        return replace(self, z=corrected, cov=by_z @ cov @ by_z.T, sensor=SensorTerms(values, z, cov))

    def bearing_range(self) -> tuple[float, float, Array]:
        """The same observation of a point in polar coordinates: bearing (rad), range (m) and their covariance (2, 2).

        The mean of a range exceeds the range of the mean by sigma_t^2 / 2 r for an error sigma_t across the beam. This
        bias is removed (Lerro and Bar-Shalom, IEEE TAES 29(3), 1993, to second order), as is the bias of the bearing
        from a correlation of the errors along and across. For a point nearer than its own error the expansion fails:
        there the bearing's sigma is at most pi, and the range is kept above zero, at a fraction of the error.
        """
        x, y = float(self.z[0]), float(self.z[1])
        r, bearing = math.hypot(x, y), math.atan2(y, x)
        c, s = math.cos(bearing), math.sin(bearing)
        to_polar = np.array([[-s, c], [c, s]])  # across the beam, along it
        (across, mixed), (_, along) = to_polar @ self.cov @ to_polar.T
        arm = max(r, math.sqrt(across) / math.pi)
        cov = np.array([[across / arm**2, mixed / arm], [mixed / arm, along]])
        return bearing + mixed / arm**2, max(r - 0.5 * across / arm, 0.5 * arm), cov


def polar_observation(
    distance: float, bearing: float, variances: tuple[float, float], floor_m: float = 0.0
) -> Observation:
    """An observation from range (m) and bearing (rad) with `variances` in that order, m^2 and rad^2.

    A bearing error biases the mean of the point towards the sensor by the factor exp(-variance / 2); this bias is
    removed (Lerro and Bar-Shalom, IEEE TAES 29(3), 1993). `Observation.bearing_range` is the inverse.
    """
    reach = distance * math.exp(0.5 * variances[1])
    turn = rotation(bearing)
    cov = turn @ np.diag([variances[0], distance**2 * variances[1]]) @ turn.T
    z = reach * turn[:, 0]
    return Observation(Kind.CORNER, z, 0.5 * (cov + cov.T) + floor_m**2 * np.eye(2))


def predict(pose: Pose, landmarks: Array, walls: NDArray[np.bool_]) -> tuple[Array, Array, Array]:
    """Predict the observations of m landmarks (m, 2), of which those marked in `walls` (m,) are walls.

    For estimators outside the package. Returns z (m, 2) and its Jacobians by the pose (m, 2, 3) and by the landmark
    (m, 2, 2).
    """
    return predictions(pose.triple(), landmarks, walls)


def innovations(z: Array, predicted: Array, walls: NDArray[np.bool_]) -> Array:
    """(..., 2) z - predicted; the angle of those marked in `walls` is wrapped. For estimators outside the package."""
    difference = z - predicted
    difference[..., 0] = np.where(walls, wrap_angle(difference[..., 0]), difference[..., 0])
    return np.asarray(difference)


def line_errors(cov: Array) -> tuple[Array, Array, Array]:
    """A line's error as a turn about its centre and a shift there, which are independent of each other.

    `cov` (..., 2, 2) of alpha and d. Returns where along the line, from the foot of its perpendicular, the centre is,
    metres, and the variances of the turn, rad^2, and of the shift, m^2; (...) each.
    """
    lever = cov[..., 0, 1] / cov[..., 0, 0]
    return lever, cov[..., 0, 0], cov[..., 1, 1] - lever * cov[..., 0, 1]


def line_point(line: Array, lever: float) -> Array:
    """(2,) the point of a line (2,), alpha and d, that lies `lever` along it from the foot of its perpendicular, m."""
    return np.asarray(line_ends(line, lever, lever)[0])


def observed_centre(observation: Observation) -> Array:
    """(2,) the centre of the returns of an observed wall, robot's frame."""
    lever, _, _ = line_errors(observation.cov)
    return line_point(observation.z, float(lever))


def initialize_landmark(pose: Pose, observation: Observation) -> tuple[Array, Array, Array]:
    """The landmark (2,) of an observation from a pose, world frame; its Jacobians by pose (2, 3) and by z (2, 2)."""
    if not observation.is_wall:
        by_z = rotation(pose.theta)
        x, y = offset = by_z @ observation.z
        return pose.position + offset, np.array([[1.0, 0.0, -y], [0.0, 1.0, x]]), by_z
    alpha = wrap_angle(float(observation.z[0]) + pose.theta)
    c, s = math.cos(alpha), math.sin(alpha)
    lever = -s * pose.x + c * pose.y
    mean = np.array([alpha, float(observation.z[1]) + c * pose.x + s * pose.y])
    return mean, np.array([[0.0, 0.0, 1.0], [c, s, lever]]), np.array([[1.0, 0.0], [lever, 1.0]])


def rotation_generator(landmarks: Array, walls: NDArray[np.bool_] | None = None) -> Array:
    """Derivative of landmarks (m, 2), or of one (2,), by a rotation of the world about its origin, per radian.

    For a point it is the point rotated by a quarter turn; for those marked in `walls` (m,) only the angle changes.
    """
    change = np.stack([-landmarks[..., 1], landmarks[..., 0]], axis=-1)
    return change if walls is None else np.where(walls[:, None], np.array([1.0, 0.0]), change)
