"""The interface of extractors, from a scan to observations of landmarks, with its contract."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from sixthsense.core.landmarks import Observation
from sixthsense.core.laser import Scan
from sixthsense.slam.features.extraction import Features


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


def features_fault(found: object) -> str:
    """What is wrong with what an extractor returns; "" if nothing."""
    if not isinstance(found, Features):
        return f"found a {type(found).__name__}, allowed: Features"
    if np.asarray(found.walls).shape[1:] != (2, 2) or not np.isfinite(found.walls).all():
        return f"found walls {np.shape(found.walls)}, allowed: finite numbers, (W, 2, 2)"
    for k, observation in enumerate(found.observations):
        if fault := _observation_fault(observation):
            return f"observation {k}: {fault}"
    return ""


def _observation_fault(observation: Observation) -> str:
    if not isinstance(observation, Observation):
        return f"found a {type(observation).__name__}, allowed: an Observation"
    z, cov = np.asarray(observation.z), np.asarray(observation.cov)
    if z.shape != (2,) or not np.isfinite(z).all():
        return f"found z {z.tolist()}, allowed: (2,) finite numbers"
    if cov.shape != (2, 2) or not np.isfinite(cov).all():
        return f"found cov {cov.tolist()}, allowed: (2, 2) finite numbers"
    asymmetry, least = float(np.abs(cov - cov.T).max()), float(np.linalg.eigvalsh(cov)[0])
    if asymmetry > 1e-9 * np.abs(cov).max() or least <= 0.0:
        return f"found cov {cov.tolist()} with an eigenvalue of {least:.3g}, allowed: symmetric, above 0"
    return ""
