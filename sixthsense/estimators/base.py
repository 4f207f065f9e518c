"""The estimators' seam: what every back end offers the loop, and the promises it keeps."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from sixthsense.geometry import Array, Pose
from sixthsense.landmarks import LandmarkId, Sighting
from sixthsense.motion import Odometry


@dataclass(frozen=True, slots=True)
class Estimate:
    """What an estimator believes now; arrays are copies."""

    pose: Pose
    """`T_world_robot`"""
    pose_cov: Array
    """(3, 3) of (x, y, theta), world frame; m, rad"""
    ids: NDArray[np.int64]
    """(n,) of the landmarks, in the order of `landmarks`"""
    landmarks: Array
    """(n, 2) means; a point's x, y in the world frame, m"""


class Estimator(Protocol):
    """Simultaneous localisation and mapping from odometry and sightings with known association.

    1. `predict` never shrinks the joint covariance; many may precede an update.
    2. `update` takes each sighting as independent; an unknown id is a new landmark, augmented after all updates.
    3. An empty update leaves the covariance alone.
    4. `joint_covariance` is symmetric and positive semi-definite, begins with `pose_cov` and follows the order asked.
    5. What is returned is a copy.
    6. The same calls give the same bits.
    """

    def predict(self, odometry: Odometry) -> None:
        """Move by an increment in the robot's frame."""
        ...

    def update(self, sightings: Mapping[LandmarkId, Sighting]) -> None:
        """Take in what one key scan saw."""
        ...

    def forget(self, ids: Collection[LandmarkId]) -> None:
        """Remove landmarks; KeyError for one that is not known."""
        ...

    def estimate(self) -> Estimate:
        """The present pose with its covariance, and the landmarks' means."""
        ...

    def joint_covariance(self, ids: Sequence[LandmarkId]) -> Array:
        """(3 + 2k, 3 + 2k) of the pose and the k landmarks, world frame, in the order asked; KeyError if unknown."""
        ...

    def trajectory(self) -> Array:
        """(K, 3), the pose at each update so far, smoothed if the estimator smooths."""
        ...
