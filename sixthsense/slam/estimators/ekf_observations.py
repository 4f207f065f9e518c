"""What a filter expects to observe of its landmarks, and new landmarks, with their Jacobians."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sixthsense.core.geometry import Array, Pose, rotation
from sixthsense.core.landmarks import Observation, initialize_landmark, observed_centre, predict, translated


class Expected(NamedTuple):
    """Observations that a filter expects."""

    z: Array
    """(m, 2) at the estimate"""
    by_pose: Array
    """(m, 2, 3) at the linearization point"""
    by_landmark: Array
    """(m, 2, 2) at the linearization point"""


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


def expected(
    pose: Pose, means: Array, point: Array, anchors: Array, walls: NDArray[np.bool_], centres: Array
) -> Expected:
    """What is expected of landmarks `means` (m, 2), walls about `centres` (m, 2), from a pose in their frame.

    The Jacobians are taken at the robot's linearization `point` (2,) and at the landmarks' `anchors` (m, 2).
    """
    z, _, _ = predict(pose, translated(means, walls, centres)[0], walls)
    about_start, by_mean = translated(anchors, walls, centres)
    _, by_pose, by_landmark = predict(Pose(point[0], point[1], pose.theta), about_start, walls)
    return Expected(z, by_pose, by_landmark @ by_mean)


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
    about, by_mean = translated(mean[None], np.array([observation.is_wall]), -centre[None])
    return about[0], by_mean[0] @ by_pose, by_mean[0] @ by_z
