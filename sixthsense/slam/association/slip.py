"""A robot that is not where it is believed to be: hardly a landmark matches, and all would if the robot had slipped.

The wheels have missed a motion: they slip, or the robot is pushed. Its covariance is added to the pose, and the matches
are searched anew, at several headings, since geometry is compared at a pose. The matches must agree about the slip: D^2
is that of all of them together.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from sixthsense.core.geometry import Array, Pose
from sixthsense.core.landmarks import LandmarkId
from sixthsense.core.motion import Odometry
from sixthsense.slam.association.matching import Matches
from sixthsense.slam.estimators.base import Belief, Estimate

_LEAST = 3
"""landmarks that tell where the robot is, and whether a few others are wrong"""
_SIGMA_M, _STEP_RAD = 0.5, 0.25
"""sigma of the position, and the step of the headings that are tried, whose sigma is half of it"""
_STEPS = sorted(range(-2, 3), key=abs)
SLIP_SIGMAS = np.array([_SIGMA_M, _SIGMA_M, max(_STEPS) * _STEP_RAD])
"""of a slip, m, m and rad"""


class Slipped:
    """A belief after a slip, whose covariance is the same along all directions."""

    def __init__(self, belief: Belief, slip: Odometry) -> None:
        self._belief, self._slip = belief, slip

    def estimate(self) -> Estimate:
        """The present pose with its covariance, and the landmarks' means."""
        before = self._belief.estimate()
        return replace(before, pose=before.pose @ self._slip.motion, pose_cov=before.pose_cov + self._slip.cov)

    def joint_covariance(self, ids: Sequence[LandmarkId]) -> Array:
        """(3 + 2k, 3 + 2k) of the pose and the landmarks asked for, in that order."""
        joint = self._belief.joint_covariance(ids)
        joint[:3, :3] += self._slip.cov
        return joint


def matches_after_slip(
    at: Callable[[Belief, Estimate], Matches], belief: Belief, estimate: Estimate, price: float
) -> tuple[Matches, Odometry | None]:
    """The matches at a belief's pose, or where the robot is after a slip, and the slip; None: it has not slipped.

    `at` gives the matches at a belief with that estimate. Of all headings that are tried that is taken at which the
    matches are worth most. They must be worth more than those without a slip by its own squared distance and by
    `price`, since slips are rare, and three landmarks may lie alike in another place.
    """
    here = at(belief, estimate)
    if len(estimate.ids) < _LEAST or not _says_slip(here):
        return here, None
    cov = np.diag([_SIGMA_M, _SIGMA_M, 0.5 * _STEP_RAD]) ** 2
    best, by, most = here, None, here.worth
    for step in _STEPS:
        slip = Odometry(Pose(theta=step * _STEP_RAD), cov)
        found = _after(slip, at, belief)
        if _matched(found) < _LEAST:
            continue
        slip = Odometry(estimate.pose.inverse() @ found.pose, cov)  # geometry is compared anew where these matches are
        found = _after(slip, at, belief)
        worth = found.worth - float(np.sum((slip.motion.array() / SLIP_SIGMAS) ** 2)) - price
        if worth > most:
            best, by, most = found, slip, worth
    return best, by


def _after(slip: Odometry, at: Callable[[Belief, Estimate], Matches], belief: Belief) -> Matches:
    slipped = Slipped(belief, slip)
    return at(slipped, slipped.estimate())


def _says_slip(matches: Matches) -> bool:
    """Whether a scan shows landmarks, and hardly one of them where it is believed to be."""
    shown, matched = len(matches.landmark), _matched(matches)
    neither = shown - matched - int(np.count_nonzero(matches.is_new))
    return shown >= _LEAST and (matched < _LEAST - 1 or 2 * neither > shown)


def _matched(matches: Matches) -> int:
    return int(np.count_nonzero(matches.landmark >= 0))
