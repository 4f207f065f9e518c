"""The interface of extractors, from a scan to observations of landmarks, with its contract."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np

from sixthsense.config.errors import PartError
from sixthsense.config.tree import check_returned
from sixthsense.core.covariance import covariance_fault
from sixthsense.core.landmarks import Observation
from sixthsense.core.laser import Scan
from sixthsense.slam.features.extraction import Features

_SINGULAR = 1e-15
"""least eigenvalue of a covariance, over its largest entry"""


class Extractor(Protocol):
    """Finds landmarks in a scan.

    It is made with the noise that the estimator assumes, an `AssumedConfig`, and with an object of its `Options`, if it
    has any.

    1. Observations are in the robot's frame, m and rad, in which `scan.T_robot_laser` is the laser's pose. `z` of a
       point is (x, y), of a wall (alpha, d), the direction of its normal and its distance from the robot.
    2. `cov` (2, 2) of an observation is that of the error of `z`: symmetric, positive definite, and as large as its
       errors are. What is off in the same way at each look, as a wall that is not straight, is part of it.
    3. Errors of the observations of a scan are independent: a return is evidence once.
    4. A scan in which it finds nothing has no observations; that is no error.
    5. The same scans give the same bits, and the scan stays as it is.
    """

    def extract(self, scan: Scan) -> Features:
        """The landmarks of one keyframe's scan, which is de-skewed."""
        ...


def check_features(part: str, found: Any) -> None:
    """Raise PartError unless what an extractor returns are features with finite walls, and valid observations."""
    check_returned(part, "extract", found, Features, walls=(None, 2, 2))
    for one in found.observations:
        check_returned(part, "extract", one, Observation, z=(2,), cov=(2, 2))
        if fault := covariance_fault(np.asarray(one.cov), lowest=_SINGULAR):
            raise PartError(part, f"extract: cov has {fault}")
