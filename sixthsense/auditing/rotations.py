"""Rotations of the plane and of space as (N, n, n) matrices, n = 2 or 3, with (N, 1) or (N, 3) rotation vectors."""

from __future__ import annotations

import numpy as np

from sixthsense.core.geometry import Array, wrap_angle


def exp(vectors: Array) -> Array:
    """(N, n, n) rotations by (N, 1) angles or (N, 3) rotation vectors, radians."""
    if vectors.shape[1] == 1:
        c, s = np.cos(vectors[:, 0]), np.sin(vectors[:, 0])
        return np.stack([np.stack([c, -s], axis=1), np.stack([s, c], axis=1)], axis=1)
    from scipy.spatial.transform import Rotation  # here, since it takes a while to load

    return np.asarray(Rotation.from_rotvec(vectors).as_matrix())


def log(rotations: Array) -> Array:
    """(N, 1) angles in [-pi, pi) or (N, 3) rotation vectors of (N, n, n) rotations, radians."""
    if rotations.shape[1] == 2:
        return wrap_angle(np.arctan2(rotations[:, 1, 0], rotations[:, 0, 0]))[:, None]
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_matrix(rotations).as_rotvec())


def of_quaternions(quaternions: Array) -> Array:
    """(N, 3, 3) rotations of (N, 4) quaternions x y z w, of any norm but 0."""
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_quat(quaternions).as_matrix())


def yaw(rotations: Array) -> Array:
    """(N,) headings of (N, n, n) rotations, radians."""
    return np.arctan2(rotations[:, 1, 0], rotations[:, 0, 0])


def transposed(rotations: Array) -> Array:
    """(N, n, n) inverse rotations."""
    return rotations.transpose(0, 2, 1)


def axes(rotations: Array) -> Array:
    """(N, d, d) matrices that turn errors of poses, translation first: the rotation twice, or once beside a 1."""
    n = rotations.shape[1]
    size = 3 if n == 2 else 6
    out = np.zeros((len(rotations), size, size))
    out[:, :n, :n] = rotations
    out[:, n:, n:] = rotations if n == 3 else 1.0
    return out


def levers(arms: Array) -> Array:
    """(N, d, d) matrices that carry a pose's error to the end of (N, n) `arms`, a turn moves the end by turn x arm."""
    n = arms.shape[1]
    size = 3 if n == 2 else 6
    out = np.tile(np.eye(size), (len(arms), 1, 1))
    moved = np.cross(np.eye(3), np.pad(arms, ((0, 0), (0, 3 - n)))[:, None])  # (N, axis of the turn, 3)
    out[:, :n, n:] = moved[:, n - size :, :n].transpose(0, 2, 1)
    return out
