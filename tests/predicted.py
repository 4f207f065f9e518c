"""Predicted observations in plain NumPy, with Jacobians: what tests compare the kernels with, and simulate by."""

from __future__ import annotations

import math

import numpy as np

from sixthsense.core.geometry import Array, Pose, wrap_angle
from sixthsense.core.landmarks import Kind, Observation


def predict_points(pose: Pose, landmarks: Array) -> tuple[Array, Array, Array]:
    """Predict the observations of m points from a pose (report eq. 5).

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


def predict_walls(pose: Pose, walls: Array) -> tuple[Array, Array, Array]:
    """Predict the observations of m walls from a pose.

    `walls` (m, 2) alpha, d in the world frame. Returns z (m, 2) in the robot's frame, its Jacobians by the pose
    (m, 2, 3) and by the wall (m, 2, 2).
    """
    normal, along = _axes(walls[:, 0])
    z = np.column_stack([wrap_angle(walls[:, 0] - pose.theta), walls[:, 1] - normal @ pose.position])
    by_pose = np.zeros((len(walls), 2, 3))
    by_pose[:, 0, 2] = -1.0
    by_pose[:, 1, :2] = -normal
    by_wall = np.zeros((len(walls), 2, 2))
    by_wall[:, 0, 0] = by_wall[:, 1, 1] = 1.0
    by_wall[:, 1, 0] = -along @ pose.position
    return z, by_pose, by_wall


def _axes(alpha: Array) -> tuple[Array, Array]:
    """(m, 2) normals of walls and (m, 2) directions, which are a quarter turn counter-clockwise of them."""
    c, s = np.cos(alpha), np.sin(alpha)
    return np.column_stack([c, s]), np.column_stack([-s, c])


def ideal_wall(pose: Pose, ends: Array, cov: Array) -> Observation:
    """The observation with `cov` (2, 2) of a wall between two places (2, 2) in the world, without an error."""
    first, last = pose.inverse() @ ends
    normal = np.array([first[1] - last[1], last[0] - first[0]]) / math.dist(first, last)
    normal = -normal if normal @ first > 0.0 else normal  # towards the robot
    along = np.array([-normal[1], normal[0]])
    low, high = sorted((float(along @ first), float(along @ last)))
    return Observation(Kind.WALL, np.array([math.atan2(normal[1], normal[0]), normal @ first]), cov, (low, high))
