"""The algebra of a filter: expected observations, new landmarks, and symmetric matrices.

A symmetric matrix is kept as its lower triangle in a column-major array.
"""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from sixthsense.core.geometry import Array, Pose, rotation
from sixthsense.core.landmark_kernels import predictions, translations
from sixthsense.core.landmarks import Observation, initialize_landmark, observed_centre
from sixthsense.core.se2 import Triple, wrapped


class NewLandmark(NamedTuple):
    """A landmark at its first observation."""

    mean: Array
    """(2,) in the world of the pose, a wall about `centre`"""
    centre: Array
    """(2,) of a wall's returns; zero of a point, and of a wall whose offset is from the origin"""
    anchor: Array
    """(2,) as `mean`, seen from the linearization point"""
    by_pose: Array
    """(2, 3) there"""
    by_z: Array
    """(2, 2)"""


@numba.njit(cache=True, error_model="numpy")
def expected(
    pose: Triple, means: Array, point: Array, anchors: Array, walls: NDArray[np.bool_], centres: Array
) -> tuple[Array, Array, Array]:
    """Expected observations (m, 2) of landmarks `means` (m, 2), walls about `centres` (m, 2), from a pose.

    Also returns their Jacobians by the pose (m, 2, 3) and by the landmark (m, 2, 2), taken at the robot's linearization
    `point` (2,) and at the landmarks' `anchors` (m, 2).
    """
    z, _, _ = predictions(pose, translations(means, walls, centres)[0], walls)
    about_start, by_mean = translations(anchors, walls, centres)
    _, by_pose, by_landmark = predictions((point[0], point[1], pose[2]), about_start, walls)
    for k in range(len(means)):  # the first row of `by_mean` is (1, 0), and its last number 1
        for row in range(2):
            by_landmark[k, row, 0] += by_landmark[k, row, 1] * by_mean[k, 1, 0]
    return z, by_pose, by_landmark


def new_landmark(pose: Pose, point: Array, observation: Observation, has_centre: bool) -> NewLandmark:
    """A landmark observed from a pose; its Jacobian by the pose is taken at the linearization `point` (2,)."""
    centre = np.zeros(2)
    if has_centre and observation.is_wall:
        centre = pose.position + rotation(pose.theta) @ observed_centre(observation)
    mean, _, by_z = _initialized(pose, observation, centre)
    anchor, by_pose, _ = _initialized(Pose(point[0], point[1], pose.theta), observation, centre)
    return NewLandmark(mean, centre, anchor, by_pose, by_z)


def _initialized(pose: Pose, observation: Observation, centre: Array) -> tuple[Array, Array, Array]:
    mean, by_pose, by_z = initialize_landmark(pose, observation)
    about, by_mean = translations(mean[None], np.array([observation.is_wall]), -centre[None])
    return about[0], by_mean[0] @ by_pose, by_mean[0] @ by_z


@numba.njit(cache=True, error_model="numpy")
def add(means: Array, walls: NDArray[np.bool_], shift: Array) -> None:
    """Add a correction (2n,) to the means (n, 2) of landmarks, in place; the angles of walls are wrapped."""
    for k in range(len(means)):
        first = means[k, 0] + shift[2 * k]
        means[k, 0] = wrapped(first) if walls[k] else first
        means[k, 1] += shift[2 * k + 1]


@numba.njit(cache=True, error_model="numpy")
def propagate(upper: Array, by_head: Array, noise: Array) -> None:
    """Move the first k parts of a state, in place: Sigma = F Sigma F^T + N with the Jacobian F, `by_head` (k, k).

    `upper` is the transpose of Sigma (n, n). N is `noise` (3, 3) of the pose.
    """
    k = len(by_head)
    moved, column = np.empty((k, k)), np.empty(k)  # F Sigma of the head
    for j in range(len(upper)):
        for i in range(k):
            column[i] = upper[min(i, j), max(i, j)]
        for i in range(k):
            total = 0.0
            for other in range(k):
                total += by_head[i, other] * column[other]
            if j < k:
                moved[i, j] = total
            else:
                upper[i, j] = total
    for i in range(k):
        for j in range(i, k):
            total = noise[i, j] if j < 3 else 0.0
            for other in range(k):
                total += moved[i, other] * by_head[j, other]
            upper[i, j] = total


@numba.njit(cache=True, error_model="numpy")
def seen_through(upper: Array, index: NDArray[np.int64], H: Array, noise: Array) -> tuple[Array, Array]:
    """H Sigma (2m, n), and H Sigma H^T + noise (2m, 2m), where H has the columns `H` (2m, k) at `index` (k,) alone.

    `upper` is the transpose of Sigma (n, n), `noise` (m, 2, 2) of the observations.
    """
    rows, n = len(H), len(upper)
    found, cross, S = columns(upper, index), np.zeros((rows, n)), np.zeros((rows, rows))
    for a in range(rows):
        for b in range(len(index)):
            if H[a, b] != 0.0:
                for j in range(n):
                    cross[a, j] += H[a, b] * found[b, j]
    for a in range(rows):
        for other in range(rows):
            S[a, other] = noise[a // 2, a % 2, other % 2] if a // 2 == other // 2 else 0.0
            for b in range(len(index)):
                S[a, other] += cross[a, index[b]] * H[other, b]
    return cross, S


@numba.njit(cache=True, error_model="numpy")
def selected(upper: Array, index: NDArray[np.int64]) -> Array:
    """(k, k) the rows and columns at `index` (k,), which ascends, of a matrix (n, n) whose transpose is `upper`.

    The result is a transpose, too. What lies below the diagonal of a transpose is undefined.
    """
    k = len(index)
    out = np.empty((k, k))
    for j in range(k):
        for i in range(j, k):
            out[j, i] = upper[index[j], index[i]]
    return out


@numba.njit(cache=True, error_model="numpy")
def columns(upper: Array, index: NDArray[np.int64]) -> Array:
    """(k, n) the columns at `index` (k,), one a row, of a symmetric matrix (n, n) whose transpose is `upper`."""
    k, n = len(index), len(upper)
    out = np.empty((k, n))
    for j in range(k):
        i = index[j]
        for other in range(i):
            out[j, other] = upper[other, i]
        for other in range(i, n):
            out[j, other] = upper[i, other]
    return out
