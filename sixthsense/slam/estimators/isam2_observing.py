"""From observations to factors and variables: a wall that is not straight is observed as it appears.

An apparent wall is the wall and an error of its shape. That stays while the same stretch is seen from the same side.
It is a variable of its own, so that an error that stays is no new evidence of the wall.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import gtsam
from gtsam.symbol_shorthand import X

from sixthsense.core.geometry import Pose
from sixthsense.core.landmarks import LandmarkId, Observation
from sixthsense.slam.estimators.isam2_factors import Loss, to_pose, to_pose2
from sixthsense.slam.estimators.isam2_head import Head
from sixthsense.slam.estimators.isam2_observations import NO_POSE, FactorOf
from sixthsense.slam.estimators.isam2_sensor import seen_point
from sixthsense.slam.estimators.isam2_solver import Solver
from sixthsense.slam.estimators.isam2_state import Landmarks, Unsolved
from sixthsense.slam.estimators.isam2_walls import exact_factor, stretch_factor, wall_factor


class Observing:
    """Adds the observations of an update to what waits to be solved."""

    def __init__(self, solver: Solver, landmarks: Landmarks, head: Head, loss: Loss | None) -> None:
        self._solver, self._landmarks, self._head, self._loss = solver, landmarks, head, loss

    def add(
        self, pose: int, guess: Pose, observations: Mapping[LandmarkId, Observation], waiting: Unsolved
    ) -> list[FactorOf]:
        """Add the factors of what is observed from a pose, and the variables that they need; what each is of."""
        rows: list[FactorOf] = []
        for i, observation in observations.items():
            is_new = i not in self._landmarks.keys
            if is_new:
                self._landmarks.add(i, guess, observation, waiting.values)
            if observation.shape_cov is not None and (i, observation.stretch) not in self._landmarks.stretches:
                self._add_stretch(i, guess, observation, waiting)
                rows.append(FactorOf(NO_POSE, i, observation, True))
            waiting.graph.add(self._factor(i, (int(X(pose)), guess), observation, is_new, waiting.values))
            rows.append(FactorOf(pose, i, observation, is_new))
        return rows

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
