"""Landmarks and their sightings: what a landmark's two numbers mean, how it is predicted, and how it is born."""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass

import numpy as np

from sixthsense.geometry import Array, Pose

LandmarkId = int


class Kind(enum.IntEnum):
    """What a landmark is; corners and loose ends are points (x, y), one family that may be matched with each other."""

    CORNER = 0
    """Where two walls meet."""
    END = 1
    """Where a wall ends."""


@dataclass(frozen=True, slots=True)
class Sighting:
    """One landmark as one scan saw it."""

    kind: Kind
    z: Array
    """(2,) position in the robot's frame, metres (report eq. 5)"""
    cov: Array
    """(2, 2) of z, m^2"""

    def bearing_range(self) -> tuple[float, float, Array]:
        """The same sighting in polar coordinates: bearing (rad), range (m) and their covariance (2, 2), in that order.

        The mean of a range is longer than the range of the mean, by sigma_t^2 / 2 r for an error sigma_t across the
        beam; that much is taken out (Lerro and Bar-Shalom, IEEE TAES 29(3), 1993, to second order), and likewise what
        a correlation of the errors along and across does to the bearing. For a point nearer than its own error none of
        this holds: there the bearing's sigma is pi at most, and the range is some of the error, not zero.
        """
        x, y = float(self.z[0]), float(self.z[1])
        r, bearing = math.hypot(x, y), math.atan2(y, x)
        c, s = math.cos(bearing), math.sin(bearing)
        to_polar = np.array([[-s, c], [c, s]])  # across the beam, along it
        (across, mixed), (_, along) = to_polar @ self.cov @ to_polar.T
        arm = max(r, math.sqrt(across) / math.pi)
        cov = np.array([[across / arm**2, mixed / arm], [mixed / arm, along]])
        return bearing + mixed / arm**2, max(r - 0.5 * across / arm, 0.5 * arm), cov


def predict_points(pose: Pose, landmarks: Array) -> tuple[Array, Array, Array]:
    """Predict the sightings of m points from a pose (report eq. 5).

    `landmarks` (m, 2) world frame. Returns z (m, 2) in the robot's frame, its Jacobians by the pose (m, 2, 3) and by
    the landmark (2, 2), the same for every point.
    """
    c, s = math.cos(pose.theta), math.sin(pose.theta)
    world_to_robot = np.array([[c, s], [-s, c]])
    z = (landmarks - pose.position) @ world_to_robot.T
    by_pose = np.empty((len(landmarks), 2, 3))
    by_pose[:, :, :2] = -world_to_robot
    by_pose[:, 0, 2] = z[:, 1]
    by_pose[:, 1, 2] = -z[:, 0]
    return z, by_pose, world_to_robot


def born_point(pose: Pose, z: Array) -> tuple[Array, Array, Array]:
    """Where a point sighted at z (2,) lies in the world, and its Jacobians by pose (2, 3) and by z (2, 2)."""
    c, s = math.cos(pose.theta), math.sin(pose.theta)
    by_z = np.array([[c, -s], [s, c]])
    offset = by_z @ z
    by_pose = np.array([[1.0, 0.0, -offset[1]], [0.0, 1.0, offset[0]]])
    return pose.position + offset, by_pose, by_z


def turned(points: Array) -> Array:
    """How points (..., 2) move when the world turns about its origin, per radian: by a quarter turn of themselves."""
    return np.stack([-points[..., 1], points[..., 0]], axis=-1)
