"""GTSAM's ISAM2, with Cholesky factorization, and with QR once that fails numerically; what waits for it; landmarks."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, field
from typing import Literal, TypeVar

import gtsam
import numpy as np
from gtsam.symbol_shorthand import L, V, W
from numpy.typing import NDArray

from sixthsense.config import ISAM2Config
from sixthsense.core.geometry import Array, Pose, rotation
from sixthsense.core.landmarks import LandmarkId, Observation
from sixthsense.core.motion import Odometry
from sixthsense.slam.estimators.isam2_factors import to_pose2, wall_frame


@dataclass(slots=True)
class Unsolved:
    """What the solver does not have yet."""

    graph: gtsam.NonlinearFactorGraph = field(default_factory=gtsam.NonlinearFactorGraph)
    values: gtsam.Values = field(default_factory=gtsam.Values)
    motions: dict[int, tuple[Odometry, int]] = field(default_factory=dict)
    """to each of its poses from the one before, and the place of the factor in `graph`"""
    poses: list[Pose] = field(default_factory=list)
    """of updates since the last solved one, by odometry or by a link"""
    guessed: set[int] = field(default_factory=set)
    """which of them are by a link"""


@dataclass(slots=True)
class Landmarks:
    """Landmarks and their variables in the graph, in the order of the first observation."""

    keys: dict[LandmarkId, int] = field(default_factory=dict)
    is_wall: dict[LandmarkId, bool] = field(default_factory=dict)
    by_tangent: dict[LandmarkId, Array] = field(default_factory=dict)
    """(2, 3) or (2, 2) Jacobian of a landmark by its variable's tangent in GTSAM"""
    stretches: dict[tuple[LandmarkId, int], int] = field(default_factory=dict)
    """keys of the apparent walls: stretches of a wall that is not straight, by its id and the stretch's number"""
    means: Array = field(default_factory=lambda: np.zeros((0, 2)))
    """(n, 2) at the last solution"""
    made: int = 0
    """number of landmarks and apparent walls so far, forgotten ones included"""

    def add(self, i: LandmarkId, guess: Pose, observation: Observation, values: gtsam.Values) -> None:
        """Add a landmark that is observed from `guess`, and its initial value to `values`."""
        if observation.is_wall:
            values.insert(self.next_key(i, True), to_pose2(wall_frame(guess, observation)))
        else:
            bearing, distance, _ = observation.bearing_range()
            values.insert(self.next_key(i, False), guess @ (distance * rotation(bearing)[:, 0]))

    def next_key(self, i: LandmarkId, is_wall: bool) -> int:
        """The key of a landmark that is new."""
        self.keys[i], self.is_wall[i] = int(W(self.made) if is_wall else L(self.made)), is_wall
        self.made += 1
        return self.keys[i]

    def next_stretch(self, i: LandmarkId, stretch: int) -> int:
        """The key of a stretch that is new."""
        self.stretches[i, stretch] = key = int(V(self.made))
        self.made += 1
        return key

    def drop(self, ids: Collection[LandmarkId]) -> None:
        """Remove landmarks."""
        if len(self.means) == len(self.keys):
            self.means = self.means[~np.isin(self.ids(), list(ids))]
        for i in ids:
            del self.keys[i], self.is_wall[i]
        self.stretches = {at: key for at, key in self.stretches.items() if at[0] in self.keys}

    def ids(self) -> NDArray[np.int64]:
        """(n,) of the landmarks."""
        return np.array(list(self.keys), dtype=np.int64)

    def walls(self) -> NDArray[np.bool_]:
        """(n,) which of them are walls."""
        return np.array(list(self.is_wall.values()), dtype=np.bool_)


T = TypeVar("T")

NONE = -1
"""number of a pose that there is not, and of a factor that the solver does not have yet"""


class Solver:
    """Solves with Cholesky factorization until that fails, next to a certain start or among very different sigmas.

    From then on the same factors are in a solver that uses QR. Cholesky takes a third of the time, since QR stacks all
    factors of walls that are seen from everywhere. A factor keeps the number that it was given.
    """

    def __init__(self, config: ISAM2Config) -> None:
        """Start empty."""
        self.isam = gtsam.ISAM2(solver_parameters(config))
        """for reading estimates"""
        self._config, self._by_qr = config, False
        self._places: dict[int, int] = {}
        """in the graph of the solver that uses QR, of factors by number that the first solver had"""
        self._ahead = 0
        """by how much the number of a later factor exceeds its place"""

    def update(
        self, graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, gone: Sequence[int] = (), last: int | None = None
    ) -> list[int]:
        """Add factors and values, remove the factors `gone`, and solve; the numbers of the new factors, ascending.

        The variable with the key `last` is eliminated last, so that its covariance costs little; by default those of
        the new factors are. Raises RuntimeError when QR finds no solution either.
        """
        groups = extra = None
        if last is not None:
            groups, extra = gtsam.KeyGroupMap(), gtsam.KeyList()
            groups.insert2(last, 1)
            extra.push_back(last)
        try:
            places = [self._places.get(factor, factor - self._ahead) for factor in gone]
            result = self.isam.update(graph, values, places, groups, None, extra)
            return [place + self._ahead for place in result.getNewFactorsIndices()]
        except RuntimeError:
            # Before it fails the solver has added the new factors to its graph and removed the old ones.
            count = self._switch_to_qr()
            return list(range(count - graph.size(), count))

    def iterate(self, count: int = 1) -> None:
        """Solve again from the present solution."""
        for _ in range(count):
            self.update(gtsam.NonlinearFactorGraph(), gtsam.Values())

    def relinearize(self, key: int, guess: Pose) -> None:
        """Iterate while the pose with this key, linearized at `guess`, is farther than the threshold from there."""
        linearized = to_pose2(guess)
        for _ in range(self._config.iterations - 1):
            solved = self.isam.calculateEstimatePose2(key)
            if np.abs(linearized.localCoordinates(solved)).max() <= self._config.relinearize_threshold:
                return
            self.iterate()
            linearized = solved

    def covariance(self, key: int) -> Array:
        """Marginal covariance of a variable, in its own tangent."""
        return np.asarray(self._query(lambda: self.isam.marginalCovariance(key)))

    def joint_covariance(self, keys: Sequence[int]) -> Array:
        """Joint marginal covariance of variables in the order asked, each in its own tangent."""
        return np.asarray(self._query(lambda: self.isam.jointMarginalCovariance(list(keys)).fullMatrix()))

    def _query(self, query: Callable[[], T]) -> T:
        try:
            return query()
        except RuntimeError:
            self._switch_to_qr()
            return query()

    def _switch_to_qr(self) -> int:
        """Move all factors to a solver that uses QR; how many there were so far, removed ones included."""
        if self._by_qr:
            raise RuntimeError("the factor graph has no solution")
        self._by_qr = True
        factors, values = self.isam.getFactorsUnsafe(), gtsam.Values(self.isam.getLinearizationPoint())
        count = int(factors.size())
        kept = [k for k in range(count) if factors.at(k) is not None]
        graph = gtsam.NonlinearFactorGraph()
        for k in kept:
            graph.add(factors.at(k))
        self.isam = gtsam.ISAM2(solver_parameters(self._config, "QR"))
        self.isam.update(graph, values)
        self._places = {factor: place for place, factor in enumerate(kept)}
        self._ahead = count - len(kept)
        for _ in range(self._config.iterations):
            self.isam.update()
        return count


def solver_parameters(config: ISAM2Config, factorization: Literal["CHOLESKY", "QR"] = "CHOLESKY") -> gtsam.ISAM2Params:
    """GTSAM's parameters for a configuration."""
    parameters = gtsam.ISAM2Params()
    parameters.setRelinearizeThreshold(config.relinearize_threshold)
    parameters.relinearizeSkip = config.relinearize_skip
    parameters.setFactorization(factorization)
    parameters.setOptimizationParams(gtsam.ISAM2GaussNewtonParams(0.05 * config.relinearize_threshold))
    parameters.enableAdaptiveReorder = True  # a stale order costs 50 % more at the 99th percentile
    parameters.enablePartialRelinearizationCheck = True  # only below poses that have moved
    return parameters
