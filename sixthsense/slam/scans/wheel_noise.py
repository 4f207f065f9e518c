"""How large the errors of the wheels are in this run, by what scans say of their motions.

Wheels differ by more than a factor of ten. What is known of any wheels is where the estimate begins: two factors on the
sigmas of that model, one of position and one of heading, are the maximum of the likelihood of the motions so far. It is
found by expectation maximisation, with Student's distribution in place of the normal one: a motion that a slip has
spoilt tells little of the others (Lange, Little and Taylor, "Robust statistical modeling using the t distribution",
JASA 84, 1989).
"""

from __future__ import annotations

import numpy as np

from sixthsense.core.geometry import Array
from sixthsense.core.motion import Odometry

FREEDOM = 4.0
"""degrees of freedom of Student's distribution of a motion: floors and loads change, wheels slip now and then"""
_PRIOR, _MEMORY = 10.0, 200.0  # motions that the model of any wheels is worth, and that are remembered: floors differ


class WheelNoise:
    """Factors on the sigmas of wheels in general."""

    def __init__(self) -> None:
        self._variances = np.ones(2)
        """of position and heading, over those of the model"""
        self._count = _PRIOR

    @property
    def factors(self) -> Array:
        """(3,) on the sigmas of (x, y, theta)."""
        return np.sqrt(self._variances[[0, 0, 1]])

    def applied(self, odometry: Odometry) -> Odometry:
        """A motion with the covariance that it has in this run."""
        return Odometry(odometry.motion, odometry.cov * np.outer(self.factors, self.factors), odometry.wheels)

    def measured(self, stated: Array, off: Array, left: Array) -> None:
        """Take in a motion whose error is `off` (3,), known up to the covariance `left` (3, 3).

        `stated` (3, 3) is the covariance by the model; all in the axes that the motion begins in.
        """
        squares = (off**2 + np.diag(left)) / np.diag(stated)
        for k, part in enumerate((squares[:2], squares[2:])):
            n = len(part)
            weight = (FREEDOM + n) / (FREEDOM + float(part.sum()) / self._variances[k])
            found = weight * float(part.mean())
            self._variances[k] += (found - self._variances[k]) / (self._count + 1.0)
        self._count = min(self._count + 1.0, _MEMORY)
