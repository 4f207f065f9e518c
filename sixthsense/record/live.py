"""What the loop works with at the moment, for who watches a run as it goes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from sixthsense.core.geometry import Array
from sixthsense.core.landmarks import LandmarkId
from sixthsense.core.laser import Scan
from sixthsense.slam.association.associator import Associator, Record
from sixthsense.slam.estimators import Estimate, Estimator
from sixthsense.slam.features import Features


@dataclass(slots=True)
class Live:
    """`Trace.live`: to be read while `on_tick` is called, and copied if it is to be kept."""

    estimator: Estimator
    """for the landmarks' covariances"""
    records: Mapping[LandmarkId, Record]
    """of the landmarks in the estimate"""
    associator: Associator
    """to observe what it is given"""
    scan: Scan | None = None
    """the last one, as if taken at an instant; robot's frame"""
    features: Features | None = None
    """what the last key scan showed; robot's frame"""

    def point_covariances(self, estimate: Estimate) -> Array:
        """(m, 2, 2) of the m points among the landmarks of the newest estimate, world frame."""
        ids = estimate.ids[~estimate.walls].tolist()
        joint = self.estimator.joint_covariance(ids)[3:, 3:].reshape(len(ids), 2, len(ids), 2)
        each = np.arange(len(ids))
        return np.asarray(joint[each, :, each, :])
