"""What the association says of one keyframe, what it keeps of each landmark, and how crooked walls are.

A bend that the returns of one scan do not show turns the fitted line by several of its sigmas. The shape of a wall does
not depend on where the robot is, so that it is averaged over all observations of a landmark. A line that is fitted to
another part of a crooked wall differs from the landmark by about as much as the wall deviates from the line.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numba
import numpy as np

from sixthsense.core.covariance import SIGNIFICANT, mean_square_limit
from sixthsense.core.geometry import Array, Pose
from sixthsense.core.landmarks import Kind, LandmarkId, Observation, WallShape
from sixthsense.core.motion import Odometry
from sixthsense.slam.association.observed import ends, joined

MEMORY = 500.0
"""observations over which the shape of walls is averaged"""
_TILT = 3.0
"""variance of the tilt, as an offset at the ends, over the mean square of the shape: of a bend or a step anywhere"""
_LARGEST = 25.0
"""of a squared amplitude over its variance: a wall that no cut made straight says nothing of others"""


class Crookedness:
    """How crooked walls are here, in the mean: the shapes of single observations against the laser's noise."""

    def __init__(self) -> None:
        self._counts = [0.0, 0.0]
        self._squares = [0.0, 0.0]

    def add(self, shape: WallShape) -> None:
        """Take the shape of an observation; older ones are forgotten gradually."""
        for k, (c, var) in enumerate(zip(shape.amplitudes_m, shape.variances_m2, strict=True)):
            if math.isfinite(var):
                keep = 1.0 - 1.0 / MEMORY
                self._counts[k] = keep * self._counts[k] + 1.0
                self._squares[k] = keep * self._squares[k] + min(c * c / var, _LARGEST)

    @property
    def excess(self) -> tuple[float, float]:
        """Variances of both amplitudes of an unknown wall over those of the laser's noise; 0: straight."""
        first, second = (
            max(0.0, square / count - mean_square_limit(count)) if count >= 1.0 else 0.0
            for square, count in zip(self._squares, self._counts, strict=True)
        )
        return first, second


@dataclass(slots=True)
class MeanShape:
    """The mean shape of a wall over its observations."""

    observations: int = 0
    information: tuple[float, float] = (0.0, 0.0)
    """of the two amplitudes, 1 / m^2"""
    weighted: tuple[float, float] = (0.0, 0.0)
    """sums of the amplitudes over their variances, 1 / m"""

    def add(self, shape: WallShape) -> None:
        """Take the shape of another observation."""
        weights = [1.0 / var for var in shape.variances_m2]
        first, second = (w * c for w, c in zip(weights, shape.amplitudes_m, strict=True))
        self.observations += 1
        self.weighted = (self.weighted[0] + first, self.weighted[1] + second)
        self.information = (self.information[0] + weights[0], self.information[1] + weights[1])

    def square_m2(self, excess: tuple[float, float]) -> float:
        """Mean square of the deviation from a straight wall.

        Before the wall is seen an amplitude is normal with a variance of `excess` times that of a single observation;
        its mean over the observations tells the rest. A mean that is significant counts wherever walls are straight
        otherwise.
        """
        total = 0.0
        for information, weighted, prior_ratio in zip(self.information, self.weighted, excess, strict=True):
            if information > 0.0:
                mean_sq, var = (weighted / information) ** 2, 1.0 / information
                prior = prior_ratio * self.observations * var
                share = prior / (prior + var)
                expected = share * share * mean_sq + share * var
                total += max(expected, mean_sq - SIGNIFICANT**2 * var)
        return total


def less_certain(observation: Observation, square_m2: float) -> Observation:
    """The observation of a wall that deviates from a straight one by a mean square of `square_m2`."""
    if square_m2 == 0.0 or not observation.is_wall:
        return observation
    return replace(observation, cov=observation.cov + square_m2 * unit_cov(*observation.extent, True))


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


@dataclass(frozen=True, slots=True)
class Association:
    """The observations of one keyframe with the landmarks they are of."""

    observations: Mapping[LandmarkId, Observation] = field(default_factory=dict)
    """those to update with; an id that the estimator does not know is a new landmark"""
    discarded: int = 0
    """observations that are too far for a match and too near for a new landmark"""
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
    sigma_m: float = math.inf
    """upper bound of a point's sigma along any direction, when it was last compared"""
    extent: Array = field(default_factory=lambda: np.zeros((2, 2)))
    """(2, 2) ends of what was seen of a wall, world frame; unused for a point"""
    shape: MeanShape = field(default_factory=MeanShape)
    """of a wall"""

    def seen_again(self, observation: Observation, pose: Pose, wall: Array) -> None:
        """Record an observation of this wall (2,) from `pose`."""
        self.shape.add(observation.shape)
        self.extent = joined(wall, self.extent, ends(pose, observation))
