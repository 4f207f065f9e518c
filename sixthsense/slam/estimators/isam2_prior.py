"""The landmarks of an earlier run in a factor graph: one factor of all of them, with their joint covariance."""

from __future__ import annotations

import math
from collections.abc import Collection

import gtsam
import numpy as np

from sixthsense.core.covariance import root_information
from sixthsense.core.geometry import Array, wrap_angle
from sixthsense.core.landmarks import LandmarkId
from sixthsense.slam.estimators.base import LandmarkPrior
from sixthsense.slam.estimators.isam2_factors import FIRST_M, floored, lines
from sixthsense.slam.estimators.isam2_solver import Landmarks, Solver


class PriorFactor:
    """The factor, its number, and what is left of the earlier landmarks."""

    def __init__(self) -> None:
        """Begin without landmarks."""
        self._prior: LandmarkPrior | None = None
        self._frames: dict[LandmarkId, Array] = {}
        """(3,) initial frame of each wall"""
        self._number = -1

    def start(self, prior: LandmarkPrior, solver: Solver, landmarks: Landmarks) -> None:
        """Add the landmarks to an empty solver, and to `landmarks`."""
        if not len(prior.ids):
            return
        self._prior = prior
        frames = _frames(prior)
        means, axes = lines(frames)
        for k, i in enumerate(prior.ids.tolist()):
            is_wall = bool(prior.walls[k])
            landmarks.next_key(i, is_wall)
            landmarks.by_tangent[i] = axes[k] if is_wall else np.eye(2)
            if is_wall:
                self._frames[i] = frames[k]
        landmarks.means = np.where(prior.walls[:, None], means, prior.landmarks)
        factor, values = self._factor(landmarks)
        self._number = solver.update(_graph_of(factor), values)[0]

    def forget(self, ids: Collection[LandmarkId], solver: Solver, landmarks: Landmarks) -> None:
        """Leave the marginal covariance of the landmarks that are not in `ids`."""
        if self._prior is None or not np.isin(self._prior.ids, list(ids)).any():
            return
        self._prior, gone = self._prior.without(ids), [self._number]
        if not len(self._prior.ids):
            self._prior = None
            solver.update(gtsam.NonlinearFactorGraph(), gtsam.Values(), gone)
            return
        factor, _ = self._factor(landmarks)
        self._number = solver.update(_graph_of(factor), gtsam.Values(), gone)[0]

    def _factor(self, landmarks: Landmarks) -> tuple[gtsam.NonlinearFactor, gtsam.Values]:
        """The factor, and the earlier landmarks, about which it is quadratic.

        As a quadratic form it is eliminated in a third of the time that rows for all numbers of the landmarks take.
        """
        assert self._prior is not None
        values = gtsam.Values()
        ids = self._prior.ids.tolist()
        for i, mean in zip(ids, self._prior.landmarks, strict=True):
            values.insert(landmarks.keys[i], gtsam.Pose2(*self._frames[i]) if i in self._frames else mean)
        keys = [landmarks.keys[i] for i in ids]
        blocks = _jacobians(self._prior, np.array([self._frames.get(i, np.zeros(3)) for i in ids]))

        def whitened(_: gtsam.CustomFactor, values: gtsam.Values, jacobians: list[Array] | None) -> Array:
            if jacobians is not None:
                for k, block in enumerate(blocks):
                    jacobians[k] = block
            return np.zeros(len(blocks[0]))  # the landmarks are at their means

        exact = gtsam.CustomFactor(gtsam.noiseModel.Unit.Create(len(blocks[0])), keys, whitened).linearize(values)
        return gtsam.LinearContainerFactor(gtsam.HessianFactor(exact), values), values


def _graph_of(factor: gtsam.NonlinearFactor) -> gtsam.NonlinearFactorGraph:
    graph = gtsam.NonlinearFactorGraph()
    graph.add(factor)
    return graph


def _jacobians(prior: LandmarkPrior, frames: Array) -> list[Array]:
    """Of the whitened landmarks, then of each wall's shift along itself, by GTSAM's tangent of each landmark.

    `frames` (n, 3) are those of walls; of points they are unused.
    """
    n = len(prior.ids)
    root = root_information(floored(prior.cov))
    _, axes = lines(frames)
    along = np.cumsum(prior.walls) - 1 + 2 * n
    blocks = []
    for k, is_wall in enumerate(prior.walls.tolist()):
        block = np.zeros((2 * n + int(prior.walls.sum()), 3 if is_wall else 2))
        block[: 2 * n] = root[:, 2 * k : 2 * k + 2] @ axes[k] if is_wall else root[:, 2 * k : 2 * k + 2]
        if is_wall:
            block[along[k], 0] = 1.0 / FIRST_M  # the place of its origin along it is arbitrary
        blocks.append(block)
    return blocks


def _frames(prior: LandmarkPrior) -> Array:
    """(n, 3) frames of walls, whose origins are the middles of what was seen; of points they are unused."""
    alpha = prior.landmarks[:, 0]
    c, s = np.cos(alpha), np.sin(alpha)
    middle = prior.extents.mean(axis=1)
    off = prior.landmarks[:, 1] - (c * middle[:, 0] + s * middle[:, 1])
    return np.column_stack([middle[:, 0] + off * c, middle[:, 1] + off * s, wrap_angle(alpha - 0.5 * math.pi)])
