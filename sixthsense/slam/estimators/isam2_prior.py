"""The landmarks of an earlier run in a factor graph: one factor of all of them, with their joint covariance."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence

import gtsam
import numpy as np

from sixthsense.core.geometry import Array, wrap_angle
from sixthsense.core.landmarks import LandmarkId
from sixthsense.slam.estimators.base import LandmarkPrior
from sixthsense.slam.estimators.isam2_solver import Solver
from sixthsense.slam.estimators.isam2_state import Landmarks
from sixthsense.slam.estimators.isam2_walls import lines

_FLOOR = 1e-6  # sigma added to each landmark, m and rad: one that is known would make the system singular
_ALONG_M = 1e-3  # sigma of the place of a wall's origin along the wall, which is arbitrary


class PriorFactor:
    """The factor, its place in the graph, and what is left of the earlier landmarks."""

    def __init__(self) -> None:
        """Begin without landmarks."""
        self._prior: LandmarkPrior | None = None
        self._frames: dict[LandmarkId, Array] = {}
        """(3,) initial frame of each wall"""
        self._place = -1

    def start(self, prior: LandmarkPrior, solver: Solver, landmarks: Landmarks) -> None:
        """Add the landmarks to an empty solver, and to `landmarks`."""
        if not len(prior.ids):
            return
        self._prior = prior
        frames = _frames(prior)
        means, axes = lines(frames)
        values = gtsam.Values()
        for k, i in enumerate(prior.ids.tolist()):
            is_wall = bool(prior.walls[k])
            key = landmarks.next_key(i, is_wall)
            if is_wall:
                self._frames[i] = frames[k]
                values.insert(key, gtsam.Pose2(*frames[k]))
            else:
                values.insert(key, prior.landmarks[k])
            landmarks.by_tangent[i] = axes[k] if is_wall else np.eye(2)
        landmarks.means = np.where(prior.walls[:, None], means, prior.landmarks)
        self._add(solver, landmarks, values, [])

    def forget(self, ids: Collection[LandmarkId], solver: Solver, landmarks: Landmarks) -> None:
        """Leave the marginal covariance of the landmarks that are not in `ids`."""
        if self._prior is None or not np.isin(self._prior.ids, list(ids)).any():
            return
        self._prior = self._prior.without(ids)
        self._add(solver, landmarks, gtsam.Values(), [self._place])

    def renumber(self, before: Sequence[int], after: Sequence[int]) -> None:
        """Renumber the factors: those at the places `before`, ascending, are now at `after`."""
        if self._prior is not None and self._place in before:
            self._place = after[list(before).index(self._place)]

    def _add(self, solver: Solver, landmarks: Landmarks, values: gtsam.Values, gone: list[int]) -> None:
        assert self._prior is not None
        graph = gtsam.NonlinearFactorGraph()
        ids = self._prior.ids.tolist()
        if ids:
            frames = np.array([self._frames.get(i, np.zeros(3)) for i in ids])
            keys = [landmarks.keys[i] for i in ids]
            residual = Residual(self._prior, keys, frames)
            graph.add(gtsam.CustomFactor(gtsam.noiseModel.Unit.Create(residual.rows), keys, residual))
        places = solver.update(graph, values, gone)
        if ids:
            self._place = places[0]
        else:
            self._prior = None


class Residual:
    """Whitened landmarks less their means, then each wall's shift along itself; called by GTSAM."""

    def __init__(self, prior: LandmarkPrior, keys: Sequence[int], frames: Array) -> None:
        """Of the variables with these keys; `frames` (n, 3) are those that walls begin with."""
        cov = prior.cov + _FLOOR**2 * np.eye(2 * len(keys))
        self._root = np.linalg.inv(np.linalg.cholesky(cov))  # R^-1 of cov = R R^T
        self._keys, self._walls, self._means, self._frames = list(keys), prior.walls, prior.landmarks, frames
        self._of_wall = np.cumsum(prior.walls) - 1 + 2 * len(keys)
        self.rows = 2 * len(keys) + int(prior.walls.sum())
        """of the residual"""

    def __call__(self, _: gtsam.CustomFactor, values: gtsam.Values, jacobians: list[Array] | None) -> Array:
        """The residual; fills `jacobians`, if there are any, in GTSAM's tangents."""
        n = len(self._keys)
        off, along, frames = np.zeros((n, 2)), np.zeros(n), np.zeros((n, 3))
        for k, key in enumerate(self._keys):
            if self._walls[k]:
                pose = values.atPose2(key)
                frames[k] = pose.x(), pose.y(), pose.theta()
            else:
                off[k] = values.atPoint2(key) - self._means[k]
        found, axes = lines(frames)
        off[self._walls] = (found - self._means)[self._walls]
        off[self._walls, 0] = wrap_angle(off[self._walls, 0])
        c, s = np.cos(self._frames[:, 2]), np.sin(self._frames[:, 2])
        shift = frames - self._frames
        along = (c * shift[:, 0] + s * shift[:, 1])[self._walls] / _ALONG_M
        if jacobians is not None:
            for k in range(n):
                jacobians[k] = self._jacobian(k, axes[k], float(shift[k, 2]))
        return np.concatenate([self._root @ off.ravel(), along])

    def _jacobian(self, k: int, axes: Array, turned: float) -> Array:
        columns = self._root[:, 2 * k : 2 * k + 2]
        if not self._walls[k]:
            return np.vstack([columns, np.zeros((self.rows - len(columns), 2))])
        out = np.zeros((self.rows, 3))
        out[: len(columns)] = columns @ axes
        out[self._of_wall[k], :2] = math.cos(turned) / _ALONG_M, -math.sin(turned) / _ALONG_M
        return out


def _frames(prior: LandmarkPrior) -> Array:
    """(n, 3) frames of walls, whose origins are the middles of what was seen; of points they are unused."""
    alpha = prior.landmarks[:, 0]
    c, s = np.cos(alpha), np.sin(alpha)
    middle = prior.extents.mean(axis=1)
    off = prior.landmarks[:, 1] - (c * middle[:, 0] + s * middle[:, 1])
    return np.column_stack([middle[:, 0] + off * c, middle[:, 1] + off * s, wrap_angle(alpha - 0.5 * math.pi)])
