"""GTSAM's ISAM2 by Cholesky's method, and by QR where that runs out of digits."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Literal, TypeVar

import gtsam
import numpy as np

from sixthsense.config import ISAM2Config
from sixthsense.core.geometry import Array

T = TypeVar("T")


class Solver:
    """Solves by Cholesky's method, until beside an exactly known start or among very unlike sigmas it fails.

    From then on the same factors are in a solver that uses QR. Cholesky's method takes a third of the time: QR stacks
    what walls that are seen from everywhere have gathered.
    """

    def __init__(self, config: ISAM2Config, on_renumber: Callable[[Sequence[int], Sequence[int]], None]) -> None:
        """Begin with nothing; `on_renumber` is told of factors' new places: before, ascending, and after."""
        self.isam = gtsam.ISAM2(solver_parameters(config))
        """to read estimates from"""
        self._config, self._on_renumber = config, on_renumber
        self._by_qr = False

    def update(self, graph: gtsam.NonlinearFactorGraph, values: gtsam.Values, gone: Sequence[int] = ()) -> list[int]:
        """Take factors and values in, those at the places `gone` out, and solve; the places of the new factors.

        Raises RuntimeError when QR finds no solution either.
        """
        try:
            return list(self.isam.update(graph, values, list(gone)).getNewFactorsIndices())
        except RuntimeError:
            # The solver has put the new factors into its graph, and taken the old ones out, before it fails.
            places = self._turn_to_qr()
            return places[len(places) - graph.size() :]

    def covariance(self, key: int) -> Array:
        """Marginal covariance of a variable, in its own tangent."""
        return np.asarray(self._asked(lambda: self.isam.marginalCovariance(key)))

    def joint_covariance(self, keys: Sequence[int]) -> Array:
        """Joint marginal covariance of variables in the order asked, each in its own tangent."""
        return np.asarray(self._asked(lambda: self.isam.jointMarginalCovariance(list(keys)).fullMatrix()))

    def _asked(self, query: Callable[[], T]) -> T:
        try:
            return query()
        except RuntimeError:
            self._turn_to_qr()
            return query()

    def _turn_to_qr(self) -> list[int]:
        """Give all factors to a solver that uses QR; their new places."""
        if self._by_qr:
            raise RuntimeError("the factor graph has no solution")
        self._by_qr = True
        factors, values = self.isam.getFactorsUnsafe(), gtsam.Values(self.isam.getLinearizationPoint())
        kept = [k for k in range(factors.size()) if factors.at(k) is not None]
        graph = gtsam.NonlinearFactorGraph()
        for k in kept:
            graph.add(factors.at(k))
        self.isam = gtsam.ISAM2(solver_parameters(self._config, "QR"))
        places = list(self.isam.update(graph, values).getNewFactorsIndices())
        self._on_renumber(kept, places)
        for _ in range(self._config.iterations):
            self.isam.update()
        return places


def solver_parameters(config: ISAM2Config, factorization: Literal["CHOLESKY", "QR"] = "CHOLESKY") -> gtsam.ISAM2Params:
    """GTSAM's parameters for a configuration."""
    parameters = gtsam.ISAM2Params()
    parameters.setRelinearizeThreshold(config.relinearize_threshold)
    parameters.relinearizeSkip = config.relinearize_skip
    parameters.setFactorization(factorization)
    parameters.setOptimizationParams(gtsam.ISAM2GaussNewtonParams(min(1e-3, 0.1 * config.relinearize_threshold)))
    parameters.enableAdaptiveReorder = True  # an order that has grown bad costs the 99th percentile half as much again
    return parameters
