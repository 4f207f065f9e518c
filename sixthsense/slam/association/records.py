"""What the association returns for one keyframe, what it keeps of each landmark, and what it learns of a building.

A wall that is not straight differs from stretch to stretch from the line that was fitted before. The variance of that
difference is learned for each wall from its own innovations, with the mean of all walls of the building as its prior.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace

import numba
import numpy as np

from sixthsense.core.geometry import Array
from sixthsense.core.landmarks import Kind, LandmarkId, Observation
from sixthsense.core.motion import Odometry

ByLandmark = Mapping[LandmarkId, Observation]
"""observations, each of its landmark"""

_TILT = 3.0
"""variance of the tilt, as an offset at the ends, over the mean square of the shape: of a bend or a step anywhere"""
SQUARES_M2 = 1e-6 * np.array([0.0, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0])
"""(8,) variances, m^2, among which that of a wall is: none, and sigmas of 1 to 8 mm"""
_STRAIGHT, _ANY = 5.0, 0.002
"""walls without any deviation, and with one of any size, that the prior of a building begins with"""
_ALIKE = 0.2
"""intersection over union of the stretches of two looks from which on their errors are the same"""
_PAUSE = 25
"""keyframes without a look, after which the next one is from elsewhere"""
_MOST_LOOKS = 16
"""with the same error that make an observation less certain: the robot has moved on then, if by less than a stretch"""


@dataclass(frozen=True, slots=True)
class Association:
    """The observations of one keyframe with the landmarks they are of."""

    observations: ByLandmark = field(default_factory=dict)
    """those to update with; an id that the estimator does not know is a new landmark"""
    discarded: int = 0
    """observations too far for a match and too near for a new landmark, or beside another new point"""
    nis: float = 0.0
    """normalised innovation squared of all matches together, before the update"""
    dof: int = 0
    """its degrees of freedom, 2 per match"""
    fused: int = 0
    """observations that were fused with another one of the same wall"""
    slip: Odometry | None = None
    """motion that the odometry has missed, if the scan matches only with it"""


@dataclass(slots=True)
class Record:
    """What the associator keeps of a landmark, beside the estimator's two numbers."""

    kind: Kind
    """of its first observation"""
    observations: int
    """observations so far, the first included"""
    first_scan: int
    """keyframe of its first observation"""
    last_scan: int
    """keyframe of its last observation"""
    extent: Array = field(default_factory=lambda: np.zeros((2, 2)))
    """(2, 2) ends of what was seen of a wall, world frame, on its line as estimated; unused for a point"""
    log_likelihoods: Array = field(default_factory=lambda: np.zeros(len(SQUARES_M2)), repr=False, compare=False)
    """(8,) of each of `SQUARES_M2`, by the innovations of this wall; not recorded"""
    square_m2: float = field(default=0.0, compare=False)
    """posterior mean of the variance of a wall's deviation from a straight one; not recorded"""
    looks: int = field(default=1, compare=False)
    """at the stretch of the wall that is in view, from the first one on, `_MOST_LOOKS` at most; not recorded"""
    stretch: Array = field(default_factory=lambda: np.zeros((2, 2)), repr=False, compare=False)
    """(2, 2) ends of what was seen of a wall then, world frame; not recorded"""
    misread: int = field(default=0, compare=False)
    """observations that named this landmark, and contradicted it; not recorded"""

    def look(self, ends: Array, scan: int) -> bool:
        """Count a look at the `ends` (2, 2) of a wall, world frame; whether it is at another stretch than before."""
        is_anew = scan - self.last_scan > _PAUSE or _overlap(self.stretch, ends) < _ALIKE
        self.looks = 1 if is_anew else min(self.looks + 1, _MOST_LOOKS)
        if is_anew:
            self.stretch = ends
        return is_anew


@numba.njit(cache=True, error_model="numpy")
def _overlap(before: Array, now: Array) -> float:
    """Intersection over union of two stretches with the ends (2, 2) each, along the second."""
    x, y = now[1, 0] - now[0, 0], now[1, 1] - now[0, 1]
    a, b = before[0, 0] * x + before[0, 1] * y, before[1, 0] * x + before[1, 1] * y
    c, d = now[0, 0] * x + now[0, 1] * y, now[1, 0] * x + now[1, 1] * y
    either = max(a, b, c, d) - min(a, b, c, d)
    return max(0.0, min(max(a, b), max(c, d)) - max(min(a, b), min(c, d))) / either if either > 0.0 else 0.0


def on_lines(walls: Array, extents: Array) -> Array:
    """(n, 2, 2) extents moved onto the lines of walls (n, 2): a wall takes its extent along as its estimate moves.

    The length stays, and the middle moves along the normal: an estimate does not say how far a wall moved along itself.
    """
    c, s = np.cos(walls[:, 0]), np.sin(walls[:, 0])
    normal, along = np.column_stack([c, s]), np.column_stack([-s, c])
    places, span = np.einsum("nea,na->ne", extents, along), extents[:, 1] - extents[:, 0]
    half = np.copysign(0.5 * np.hypot(span[:, 0], span[:, 1]), places[:, 1] - places[:, 0])
    places = 0.5 * places.sum(axis=1, keepdims=True) + half[:, None] * [-1.0, 1.0]
    return np.asarray((walls[:, 1:] * normal)[:, None] + places[:, :, None] * along[:, None])


@numba.njit(cache=True, error_model="numpy")
def unit_cov(first: float, last: float, is_wall: bool) -> Array:
    """(2, 2) covariance that a mean square of 1 m^2 adds to an observation: an offset, and a tilt about its middle.

    The wall reaches from `first` to `last` along it, m; a point is off by as much along any axis.
    """
    cov = np.eye(2)
    if is_wall:
        middle, of_tilt = 0.5 * (first + last), 4.0 * _TILT / (last - first) ** 2
        cov[0, 0] = of_tilt
        cov[0, 1] = cov[1, 0] = middle * of_tilt
        cov[1, 1] = 1.0 + middle * middle * of_tilt
    return cov


class Crookedness:
    """How far walls deviate from straight ones: the posterior mean of one variance per wall.

    The prior of a wall is the mean posterior of all walls of the building, which begin as straight ones.
    """

    def __init__(self) -> None:
        self._log_prior = self._mean_of(np.zeros((0, len(SQUARES_M2))))

    def add(self, record: Record, value: Array, cov: Array, unit: Array) -> None:
        """Record the innovation (2,) of a wall, its covariance (2, 2) were it straight, and what 1 m^2 adds to that."""
        S = cov + SQUARES_M2[:, None, None] * unit  # (8, 2, 2) of each of `SQUARES_M2`
        record.log_likelihoods += -0.5 * (value @ np.linalg.inv(S) @ value + np.log(np.linalg.det(S)))
        record.square_m2 = self.square_m2(record)

    def update(self, records: Collection[Record]) -> None:
        """Compute the prior anew from all walls among the `records`, and their variances."""
        walls = [record for record in records if record.kind == Kind.WALL]
        posteriors = np.array([self._posterior(record) for record in walls])
        self._log_prior = self._mean_of(posteriors.reshape(-1, len(SQUARES_M2)))
        for record in walls:
            record.square_m2 = self.square_m2(record)

    def square_m2(self, record: Record) -> float:
        """Posterior mean of the variance of a wall, m^2; zero of a point."""
        return float(self._posterior(record) @ SQUARES_M2) if record.kind == Kind.WALL else 0.0

    def _posterior(self, record: Record) -> Array:
        weights = self._log_prior + record.log_likelihoods
        weights = np.exp(weights - weights.max())
        return np.asarray(weights / weights.sum())

    @staticmethod
    def _mean_of(posteriors: Array) -> Array:
        """(8,) logarithm of the mean of posteriors (n, 8) of walls, of some straight ones, and of one of any size."""
        total = posteriors.sum(axis=0) + _ANY / len(SQUARES_M2)
        total[0] += _STRAIGHT
        return np.asarray(np.log(total / total.sum()))


def less_certain(observation: Observation, record: Record) -> Observation:
    """The observation of a wall with the error of its shape, which stays while the same stretch is seen.

    Of n looks that have an error of covariance S in common, and own ones of R each, the mean has the covariance
    S + R / n. An estimator that takes them as independent finds that if the look k has (R + k S) R^-1 (R + (k - 1) S).
    """
    if record.square_m2 == 0.0:
        return observation
    shape, own, k = record.square_m2 * unit_cov(*observation.extent, True), observation.cov, record.looks
    cov = (own + k * shape) @ np.linalg.solve(own, own + (k - 1) * shape)
    return replace(observation, cov=0.5 * (cov + cov.T))
