"""Noticing that the robot is not where it is believed to be, from observations that neither match nor are new.

An observation between the gate of a match and that of a new landmark is discarded. One or two of them are noise or
clutter, which a robot that turns on the spot sees in every scan. If most are, scan after scan, the prediction is off by
more than its covariance says, and odometry alone would go on.
"""

from __future__ import annotations

import numpy as np

from sixthsense.core.geometry import Pose
from sixthsense.core.motion import Odometry

_PATIENCE = 3
"""keyframes in a row before anything is done"""
_LEAST = 3
"""discarded observations of a keyframe that say anything: with fewer, wide gates would match the next thing at hand"""
_SIGMAS = (0.05, 0.03)
"""of position, m, and heading, rad, that are added first; doubled at each further keyframe"""
_LARGEST = (1.0, 0.5)
"""of position, m, and heading, rad, that are added at a keyframe"""


class BlindZone:
    """Counts keyframes most of whose observations are discarded, and says how uncertain the pose is then.

    Keyframes with too few observations say nothing, neither that the pose is right nor that it is wrong.
    """

    def __init__(self) -> None:
        self._scans = 0

    def uncertainty(self, matched: int, new: int, discarded: int) -> Odometry | None:
        """Uncertainty of the pose beyond its covariance, as a motion of zero; None while observations match.

        `matched`, `new` and `discarded` count the observations of a keyframe. With the uncertainty the gates are wide
        enough for the right matches, so that the robot is localised again by all landmarks around it.
        """
        if discarded <= matched + new:
            self._scans = 0
            return None
        if discarded < _LEAST:
            return None
        self._scans += 1
        if self._scans < _PATIENCE:
            return None
        growth = 2.0 ** (self._scans - _PATIENCE)
        position, heading = (min(first * growth, most) for first, most in zip(_SIGMAS, _LARGEST, strict=True))
        return Odometry(Pose(), np.diag([position, position, heading]) ** 2)
