"""GTSAM's ISAM2 with Cholesky factorization, and with QR once that fails numerically."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Literal, TypeVar

import gtsam
import numpy as np

from sixthsense.config import ISAM2Config
from sixthsense.core.geometry import Array, Pose
from sixthsense.slam.estimators.isam2_factors import to_pose2

T = TypeVar("T")


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
    parameters.setOptimizationParams(gtsam.ISAM2GaussNewtonParams(min(1e-3, 0.1 * config.relinearize_threshold)))
    parameters.enableAdaptiveReorder = True  # a stale order costs 50 % more at the 99th percentile
    parameters.enablePartialRelinearizationCheck = True  # only below poses that have moved
    return parameters
