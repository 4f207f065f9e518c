"""Apparent corners: how much of a point's error stays while it is seen from the same side.

A free end is seen as ending between two beams. What lies behind it, a jamb or a chamfer, hides some of the places where
it may be: an end is not found where a beam meets that, too. So the error is off to one side, by up to half the distance
of two beams on the wall, and stays while the robot stays on that side of the end. An estimator that counts it as new
with each scan becomes sure of the wrong place.

The covariance of an observation is right for a single one. The part of it that is drawn anew is measured by the scatter
of successive observations from one side. What the scatter lacks is the part that stays. It depends on the building and
on how the wall is seen: along the wall nothing behind its end is visible, and all of the error is new.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from sixthsense.core.covariance import SIGNIFICANT, mean_square_limit
from sixthsense.core.geometry import Array, Pose, rotation
from sixthsense.core.landmarks import Bend, Observation

MEMORY = 500.0
"""observations, or pairs of them in a class, over which an error of shape is averaged"""
_SIDE_RAD = 0.2
"""turn of the side that a point is seen from, after which its error looks another by 1 / e"""
_CLASSES = 5
"""of the angle between a beam and the axis of the largest error, by its cosine"""
_INDEPENDENT = 2.0 / 3.0
"""squares of differences that share an observation with the next, each, count as so many: these have a correlation of
1/4"""
_LARGEST = 9.0
"""of a squared difference over its variance: a wrong match says nothing of the scatter"""


class Sight(NamedTuple):
    """A point as it was seen once, world frame."""

    place: Array
    """(2,)"""
    cov: Array
    """(2, 2) of a single observation"""
    axis: Array
    """(2,) unit vector along which the error is largest"""
    sigma_m: float
    """of the error along it"""
    side_rad: float
    """direction from the point to the robot"""

    @classmethod
    def of(cls, observation: Observation, pose: Pose) -> Sight:
        """That of an observation from `pose`."""
        turn = rotation(pose.theta)
        place, cov = pose @ observation.z, turn @ observation.cov @ turn.T
        variances, axes = np.linalg.eigh(cov)
        side_rad = math.atan2(pose.y - place[1], pose.x - place[0])
        return cls(place, cov, axes[:, 1], math.sqrt(variances[1]), side_rad)

    @property
    def incidence(self) -> int:
        """Class of the angle between the beam and the axis: 0 across it, the last along it."""
        along = abs(self.axis[0] * math.cos(self.side_rad) + self.axis[1] * math.sin(self.side_rad))
        return min(int(_CLASSES * along), _CLASSES - 1)


def kept_between(before: float, now: float) -> float:
    """Correlation, 0 to 1, of the errors that stay of a point seen from two sides, rad."""
    return math.exp(-((math.remainder(now - before, 2.0 * math.pi) / _SIDE_RAD) ** 2))


class Scatter:
    """Which part of a point's variance stays while its side stays, over all points, by incidence."""

    def __init__(self) -> None:
        self._counts = [0.0] * _CLASSES
        self._squares = [0.0] * _CLASSES

    def add(self, before: Sight, now: Sight) -> None:
        """Take two successive observations of a point; those from two sides say nothing of the scatter."""
        if kept_between(before.side_rad, now.side_rad) < 0.5:
            return
        off = float(now.axis @ (now.place - before.place))
        square, k = off * off / float(now.axis @ (before.cov + now.cov) @ now.axis), now.incidence
        keep = 1.0 - 1.0 / MEMORY
        self._counts[k] = keep * self._counts[k] + 1.0
        self._squares[k] = keep * self._squares[k] + min(square, _LARGEST)

    def share(self, incidence: int) -> float:
        """Share, 0 to below 1, of the variance along the axis that stays; 0 where the scatter is not too small."""
        count, square = self._counts[incidence], self._squares[incidence]
        if count < 1.0 or square >= count * mean_square_limit(_INDEPENDENT * count, -SIGNIFICANT):
            return 0.0
        return 1.0 - (square + 1.0) / (count + 1.0)  # some of the error is always new


class Corner:
    """What is kept of a point: its last observation, the error that stays, and the sides that it was seen from."""

    def __init__(self) -> None:
        self._last: Sight | None = None
        self._error = np.zeros(2)
        """(2,) of the last observation: the axis times the sigma of what stays, world frame, m"""
        self._sides: list[float] = []
        """rad, each hardly like the others"""
        self._counted: list[float] = []
        """sides that were counted as new ones"""

    def seen(self, observation: Observation, pose: Pose, scatter: Scatter, displaced_m2: float) -> Observation:
        """An observation of this point from `pose`, with the part of its error that stays, of which the scatter tells.

        The error changes by the difference of two normal ones, along the axis of each, with the correlation of their
        sides. Each side has a further error of `displaced_m2`, the variance along any axis.
        """
        now, before, was = Sight.of(observation, pose), self._last, self._error
        if before is not None:
            scatter.add(before, now)
        error = math.sqrt(scatter.share(now.incidence)) * now.sigma_m * now.axis
        self._last, self._error = now, error
        side = self._side_of(now.side_rad)
        if not error.any() and not was.any() and displaced_m2 == 0.0:
            return observation
        if error @ was < 0.0:
            was = -was
        kept = 0.0 if before is None else kept_between(before.side_rad, now.side_rad)
        both = np.outer(was, error)
        to_robot = rotation(-pose.theta)
        cov, renewal = (
            to_robot @ each @ to_robot.T
            for each in (
                np.outer(error, error),
                np.outer(was, was) + np.outer(error, error) - kept * (both + both.T),
            )
        )
        of_side = displaced_m2 * np.eye(2)
        cov, renewal = cov + of_side, renewal + 2.0 * (1.0 - kept) * of_side
        alike = kept_between(self._sides[side], now.side_rad)
        return replace(observation, cov=observation.cov + of_side, bend=Bend(cov, renewal, side, alike))

    def is_new_side(self, side_rad: float) -> bool:
        """Whether the point was seen, but never from a side like this one."""
        return self._last is not None and not _has_alike([*self._sides, self._last.side_rad], side_rad)

    def counts(self, side_rad: float) -> bool:
        """Whether this side is counted as a new one, which each is once."""
        if _has_alike(self._counted, side_rad):
            return False
        self._counted.append(side_rad)
        return True

    def _side_of(self, side_rad: float) -> int:
        """Number of the side that is most like this one; a new one, if none has most of its error."""
        alike = [kept_between(side, side_rad) for side in self._sides]
        if alike and max(alike) > 0.5:
            return alike.index(max(alike))
        self._sides.append(side_rad)
        return len(self._sides) - 1


def _has_alike(sides: list[float], side_rad: float) -> bool:
    """Whether a point shows most of its error alike from one of the `sides`, rad, and from this one."""
    return any(kept_between(side, side_rad) > 0.5 for side in sides)
