"""The algebra of a filter: expected observations and new landmarks."""

from __future__ import annotations

from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from sixthsense.core.geometry import Array, Pose, rotation
from sixthsense.core.landmark_kernels import predictions, translations
from sixthsense.core.landmarks import Observation, initialize_landmark, observed_centre
from sixthsense.core.se2 import Triple


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
