"""`Live`, the current state of the loop, for hooks and live views."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from sixthsense.core.geometry import Array
from sixthsense.core.landmarks import LandmarkId
from sixthsense.core.laser import Scan
from sixthsense.slam.association.associator import Associator
from sixthsense.slam.association.records import Record
from sixthsense.slam.estimators import Estimate, Estimator
from sixthsense.slam.features import Features


@dataclass(slots=True)
class Live:
    """`Trace.live`: valid during the call of `on_tick`; copy the values that you keep."""

    estimator: Estimator
    """the estimator, which computes the landmarks' covariances"""
    records: Mapping[LandmarkId, Record]
    """records of the landmarks in the estimate"""
    associator: Associator
    """the associator, whose inputs can be observed"""
    scan: Scan | None = None
    """the last scan, deskewed; robot's frame"""
    features: Features | None = None
    """features of the last keyframe; robot's frame"""
    since_cov: Array = field(default_factory=lambda: np.zeros((3, 3)))
    """(3, 3) of the motion since the last keyframe, axes of the keyframe"""

    def point_covariances(self, estimate: Estimate) -> Array:
        """(m, 2, 2) covariances of the m point landmarks of the latest estimate, world frame."""
        ids = estimate.ids[~estimate.walls].tolist()
        joint = self.estimator.joint_covariance(ids)[3:, 3:].reshape(len(ids), 2, len(ids), 2)
        each = np.arange(len(ids))
        return np.asarray(joint[each, :, each, :])
