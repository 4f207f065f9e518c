"""Landmarks in kernels: what is computed once or more for every landmark of a keyframe."""

from __future__ import annotations

import math

import numba
import numpy as np
from numpy.typing import NDArray

from sixthsense.core.geometry import Array
from sixthsense.core.se2 import Triple, wrapped

Mask = NDArray[np.bool_]


@numba.njit(cache=True, error_model="numpy")
def predictions(pose: Triple, landmarks: Array, walls: Mask) -> tuple[Array, Array, Array]:
    """Predicted observations (m, 2) of landmarks (m, 2), and Jacobians by pose (m, 2, 3) and landmark (m, 2, 2)."""
    m = len(landmarks)
    x, y, theta = pose
    c, s = math.cos(theta), math.sin(theta)
    z, by_pose, by_landmark = np.empty((m, 2)), np.zeros((m, 2, 3)), np.empty((m, 2, 2))
    for k in range(m):
        a, b = landmarks[k, 0], landmarks[k, 1]
        if walls[k]:
            nx, ny = math.cos(a), math.sin(a)
            z[k, 0], z[k, 1] = wrapped(a - theta), b - nx * x - ny * y
            by_pose[k, 0, 2], by_pose[k, 1, 0], by_pose[k, 1, 1] = -1.0, -nx, -ny
            by_landmark[k, 0, 0], by_landmark[k, 0, 1] = 1.0, 0.0
            by_landmark[k, 1, 0], by_landmark[k, 1, 1] = ny * x - nx * y, 1.0
        else:
            ahead, left = c * (a - x) + s * (b - y), c * (b - y) - s * (a - x)
            z[k, 0], z[k, 1] = ahead, left
            by_pose[k, 0, 0], by_pose[k, 0, 1], by_pose[k, 0, 2] = -c, -s, left
            by_pose[k, 1, 0], by_pose[k, 1, 1], by_pose[k, 1, 2] = s, -c, -ahead
            by_landmark[k, 0, 0], by_landmark[k, 0, 1] = c, s
            by_landmark[k, 1, 0], by_landmark[k, 1, 1] = -s, c
    return z, by_pose, by_landmark


@numba.njit(cache=True, error_model="numpy")
def translations(landmarks: Array, walls: Mask, by: Array) -> tuple[Array, Array]:
    """Landmarks (m, 2) after the world is translated by `by` (m, 2), and the Jacobians (m, 2, 2)."""
    m = len(landmarks)
    moved, jacobian = np.empty((m, 2)), np.empty((m, 2, 2))
    for k in range(m):
        a, b = landmarks[k, 0], landmarks[k, 1]
        x, y = by[k, 0], by[k, 1]
        jacobian[k, 0, 0], jacobian[k, 0, 1], jacobian[k, 1, 0], jacobian[k, 1, 1] = 1.0, 0.0, 0.0, 1.0
        if walls[k]:
            nx, ny = math.cos(a), math.sin(a)
            moved[k, 0], moved[k, 1] = a, b + nx * x + ny * y
            jacobian[k, 1, 0] = nx * y - ny * x
        else:
            moved[k, 0], moved[k, 1] = a + x, b + y
    return moved, jacobian


@numba.njit(cache=True, error_model="numpy")
def line_ends(line: Array, first: float, last: float) -> Array:
    """(2, 2) the points of a line (2,), alpha and d, at two places along it, m from the foot of its perpendicular."""
    c, s = math.cos(line[0]), math.sin(line[0])
    out = np.empty((2, 2))
    out[0, 0], out[0, 1] = line[1] * c - first * s, line[1] * s + first * c
    out[1, 0], out[1, 1] = line[1] * c - last * s, line[1] * s + last * c
    return out


@numba.njit(cache=True, error_model="numpy")
def innovation(z: Array, cov: Array, predicted: Array, is_wall: bool, value: Array, about: Array) -> None:
    """Fill in the innovation (2,) of an observation and its covariance (2, 2) about the prediction."""
    value[0], value[1] = z[0] - predicted[0], z[1] - predicted[1]
    for row in range(2):
        for column in range(2):
            about[row, column] = cov[row, column]
    if is_wall:
        turn = wrapped(value[0])
        c, s = math.cos(turn), math.sin(turn)
        lever = cov[0, 1] / cov[0, 0]
        turned = lever * c + z[1] * s  # the centre's place along the predicted line
        value[0], value[1] = turn, z[1] * c - lever * s - predicted[1] + turned * turn
        about[0, 1] = about[1, 0] = turned * cov[0, 0]
        about[1, 1] = cov[1, 1] - lever * cov[0, 1] + turned * turned * cov[0, 0]


@numba.njit(cache=True, error_model="numpy")
def innovations_of(z: Array, cov: Array, predicted: Array, walls: Mask) -> tuple[Array, Array]:
    """(m, 2) innovations of observations `z` (m, 2) with `cov` (m, 2, 2), and (m, 2, 2) about the predictions (m, 2).

    The error of a fitted line is a turn about the centre of its returns and a shift there, independent of each other:
    `cov` tells where the centre is. About the foot of its perpendicular, a turn by delta also moves the offset d by
    d delta^2 / 2, which for a short wall is more than the sigma of the shift and always to the same side. So the
    distance of the predicted line is taken from the centre. To first order it is z - predicted, with `cov`.
    """
    values, about = np.empty((len(z), 2)), np.empty((len(z), 2, 2))
    for k in range(len(z)):
        innovation(z[k], cov[k], predicted[k], walls[k], values[k], about[k])
    return values, about


@numba.njit(cache=True, error_model="numpy")
def stacked(by_pose: Array, by_landmark: Array, head: int) -> Array:
    """(2m, head + 2m) Jacobian by a state with the pose at its head and m landmarks after the head, in order."""
    m = len(by_pose)
    H = np.zeros((2 * m, head + 2 * m))
    for k in range(m):
        for row in range(2):
            for column in range(3):
                H[2 * k + row, column] = by_pose[k, row, column]
            for column in range(2):
                H[2 * k + row, head + 2 * k + column] = by_landmark[k, row, column]
    return H
