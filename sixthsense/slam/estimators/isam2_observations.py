"""Observations in a factor graph: their factors and variables, and their residuals at the solution.

A wall that is not straight is observed as it appears. An apparent wall is the wall and an error of its shape. That
stays while the same stretch is seen from the same side. It is a variable of its own, so that an error that stays is no
new evidence of the wall.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace

import gtsam
import numpy as np
from gtsam.symbol_shorthand import X
from numpy.typing import NDArray

from sixthsense.core.geometry import Array, Pose, wrap_angle
from sixthsense.core.landmarks import LandmarkId, Observation, observation_innovations
from sixthsense.slam.estimators.isam2_calibration import seen_point
from sixthsense.slam.estimators.isam2_factors import Loss, exact_factor, stretch_factor, to_pose, to_pose2, wall_factor
from sixthsense.slam.estimators.isam2_solution import Head
from sixthsense.slam.estimators.isam2_solver import NONE, Landmarks, Solver, Unsolved

_FIELDS = (("pose", np.int64), ("id", np.int64), ("factor", np.int64), ("wall", np.bool_), ("first", np.bool_),
           ("z", np.float64, (2,)), ("cov", np.float64, (2, 2)))  # fmt: skip


class Observations:
    """The observations with the numbers of their factors, a row each, in the order of time."""

    def __init__(self, solver: Solver, landmarks: Landmarks, head: Head, loss: Loss | None) -> None:
        self._solver, self._landmarks, self._head, self._loss = solver, landmarks, head, loss
        self._rows = np.zeros(256, dtype=list(_FIELDS))
        self._count = 0

    def add(self, pose: int, guess: Pose, observations: Mapping[LandmarkId, Observation], waiting: Unsolved) -> None:
        """Add the factors of what is observed from a pose to what waits, and the variables that they need."""
        for i, observation in observations.items():
            is_new = i not in self._landmarks.keys
            if is_new:
                self._landmarks.add(i, guess, observation, waiting.values)
            if observation.shape_cov is not None and (i, observation.stretch) not in self._landmarks.stretches:
                self._add_stretch(i, guess, observation, waiting)
                self._append(NONE, i, observation, True)  # a factor between a wall and what is seen of it
            waiting.graph.add(self._factor(i, (int(X(pose)), guess), observation, is_new, waiting.values))
            self._append(pose, i, observation, is_new)

    def solved(self, factors: Sequence[int]) -> None:
        """Take in the numbers of the factors that were added last."""
        self._rows["factor"][self._count - len(factors) : self._count] = factors

    def factors(self, ids: Collection[LandmarkId]) -> list[int]:
        """The factors of these landmarks, ascending."""
        rows = self._rows[: self._count]
        return sorted(rows["factor"][np.isin(rows["id"], list(ids))].tolist())

    def drop_poses(self, poses: Sequence[int]) -> list[int]:
        """Remove the observations from some poses; their factors."""
        if not poses:
            return []
        rows = self._rows[: self._count]
        factors: list[int] = rows["factor"][np.isin(rows["pose"], poses)].tolist()
        self.drop(factors)
        return factors

    def drop(self, factors: Collection[int]) -> None:
        """Remove the observations that have these factors."""
        rows = self._rows[: self._count]
        kept = rows[~np.isin(rows["factor"], list(factors))]
        self._rows[: len(kept)] = kept
        self._count = len(kept)

    def squared_residuals(self, poses: Array, ids: NDArray[np.int64], landmarks: Array) -> tuple[Array, Array]:
        """Squared Mahalanobis distances of all but each landmark's first observation, and their factors.

        `poses` (K, 3) world frame; `landmarks` (n, 2) are those of `ids` (n,).
        """
        rows = self._rows[: self._count]
        rows = rows[~rows["first"]]
        pose = poses[rows["pose"]]
        order = np.argsort(ids)
        landmark = landmarks[order[np.searchsorted(ids, rows["id"], sorter=order)]]
        z, cov, is_wall = (np.ascontiguousarray(rows[name]) for name in ("z", "cov", "wall"))
        c, s = np.cos(pose[:, 2]), np.sin(pose[:, 2])
        gap = landmark - pose[:, :2]
        points = np.column_stack([c * gap[:, 0] + s * gap[:, 1], -s * gap[:, 0] + c * gap[:, 1]])
        foot = np.cos(landmark[:, 0]) * pose[:, 0] + np.sin(landmark[:, 0]) * pose[:, 1]
        walls = np.column_stack([wrap_angle(landmark[:, 0] - pose[:, 2]), landmark[:, 1] - foot])
        off, cov = observation_innovations(z, cov, np.where(is_wall[:, None], walls, points), is_wall)
        return np.einsum("ni,ni->n", off, np.linalg.solve(cov, off[:, :, None])[:, :, 0]), rows["factor"]

    def _append(self, pose: int, i: LandmarkId, seen: Observation, is_first: bool) -> None:
        """Add a row; a first observation fixes its landmark, and stays where others contradict it."""
        if self._count == len(self._rows):
            self._rows = np.concatenate([self._rows, np.zeros_like(self._rows)])
        self._rows[self._count] = (pose, i, NONE, seen.is_wall, is_first, seen.z, seen.cov)
        self._count += 1

    def _add_stretch(self, i: LandmarkId, guess: Pose, observation: Observation, waiting: Unsolved) -> None:
        wall, key = self._landmarks.keys[i], self._landmarks.next_stretch(i, observation.stretch)
        frame, factor = stretch_factor((wall, self._frame(wall, waiting.values)), key, guess, observation)
        waiting.values.insert(key, to_pose2(frame))
        waiting.graph.add(factor)

    def _factor(
        self, i: LandmarkId, pose: tuple[int, Pose], observation: Observation, is_new: bool, values: gtsam.Values
    ) -> gtsam.NonlinearFactor:
        key = self._landmarks.keys[i]
        if not observation.is_wall:
            return seen_point(key, pose[0], observation, self._head.sensor, self._loss)
        if observation.shape_cov is not None:
            key = self._landmarks.stretches[i, observation.stretch]
            of_stretch = observation.stretch_kept**2 * observation.shape_cov
            observation = replace(observation, cov=observation.cov - of_stretch)
        if self._head.wheels is not None and not is_new:
            return exact_factor(key, pose[0], observation, self._loss)
        return wall_factor((key, self._frame(key, values)), pose, observation, is_new, self._loss)

    def _frame(self, key: int, waiting: gtsam.Values) -> Pose:
        """The frame of a wall as far as it is known."""
        return to_pose(waiting.atPose2(key) if waiting.exists(key) else self._solver.isam.calculateEstimatePose2(key))
