"""Victoria Park with known landmarks: the estimator `isam2` against direct calls of GTSAM's ISAM2.

The log comes with GTSAM: 6,969 poses and 3,640 observations of 151 trees. As in a replay, a step is a pose with an
observation, and odometry between two steps is composed into one motion. Both sides have the same factors, noise,
initial values and parameters.

Timed for the estimator: `predict`, `update` and `estimate`, which returns the pose, its covariance and all landmarks.
Timed for the direct calls (`by_hand`): construction of the factors, `ISAM2.update`, and reading the same three results
by `calculateEstimate`, `marginalCovariance` and the landmarks as an array. The sides alternate step by step, and so
does their order.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter

import gtsam
import numpy as np
from gtsam.symbol_shorthand import L, X
from runs import Figures, Setting

from sixthsense.config import ISAM2Config, preset
from sixthsense.core.geometry import Array, Pose
from sixthsense.core.landmarks import LandmarkId, Observation
from sixthsense.core.motion import STANDSTILL, Odometry
from sixthsense.logs.graph import read_graph
from sixthsense.logs.log import Log
from sixthsense.slam.estimators import Estimator, make_estimator
from sixthsense.slam.estimators.isam2 import ISAM2
from sixthsense.slam.estimators.isam2_graph import solver_parameters

FILE = Path(gtsam.__file__).parent / "Data" / "victoria_park.txt"
FLOOR = 1e-6  # m, rad; sigma that isam2 adds to every motion, so that an exact start is not singular


@dataclass(frozen=True, slots=True)
class Step:
    """A pose with an observation, as objects of this package and as numbers for GTSAM."""

    odometry: Odometry
    """motion since the previous step"""
    observations: Mapping[LandmarkId, Observation]
    motion: tuple[float, float, float]
    motion_cov: Array
    """(3, 3), in the frame of the robot after the motion"""
    seen: tuple[tuple[LandmarkId, float, float, Array], ...]
    """landmark, bearing, range, and their covariance (2, 2)"""


def steps_of(log: Log) -> list[Step]:
    """The steps of a log whose ticks have the covariance of their motion."""
    steps, since, before = [], STANDSTILL, log.ticks[0].odometry
    for tick in log.ticks:
        if tick.increment_cov is not None:
            since = since.then(Odometry(before.inverse() @ tick.odometry, tick.increment_cov))
        before = tick.odometry
        if tick.observations:
            cov = since.cov + FLOOR**2 * np.eye(3)
            seen = tuple((i, *observation.bearing_range()) for i, observation in tick.observations.items())
            motion = (since.motion.x, since.motion.y, since.motion.theta)
            steps.append(Step(since, tick.observations, motion, cov, seen))
            since = STANDSTILL
    return steps


class ByHand:
    """Direct calls of GTSAM's ISAM2."""

    def __init__(self, config: ISAM2Config) -> None:
        self.isam = gtsam.ISAM2(solver_parameters(config))
        self._config = config
        self._poses = 0
        self._pose = gtsam.Pose2()
        self._known: set[LandmarkId] = set()

    def step(self, step: Step) -> object:
        """Add a step and read the result."""
        graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        motion = gtsam.Pose2(*step.motion)
        noise = gtsam.noiseModel.Gaussian.Covariance(step.motion_cov)
        key = X(self._poses)
        if self._poses == 0:
            graph.add(gtsam.PriorFactorPose2(key, motion, noise))
        else:
            graph.add(gtsam.BetweenFactorPose2(key - 1, key, motion, noise))
        guess = self._pose.compose(motion)
        values.insert(key, guess)
        self._poses += 1
        for i, bearing, distance, cov in step.seen:
            noise = gtsam.noiseModel.Gaussian.Covariance(cov)
            graph.add(gtsam.BearingRangeFactor2D(key, L(i), gtsam.Rot2(bearing), distance, noise))
            if i not in self._known:
                self._known.add(i)
                at = distance * np.array([np.cos(bearing), np.sin(bearing)])
                values.insert(L(i), guess.transformFrom(at))
        self.isam.update(graph, values)
        linearised = guess
        for _ in range(self._config.iterations - 1):
            solved = self.isam.calculateEstimatePose2(key)
            if np.abs(linearised.localCoordinates(solved)).max() <= self._config.relinearize_threshold:
                break
            self.isam.update()
            linearised = solved
        estimate = self.isam.calculateEstimate()
        self._pose = estimate.atPose2(key)
        return self._pose, self.isam.marginalCovariance(key), gtsam.utilities.extractPoint2(estimate)


def graph_error(isam: gtsam.ISAM2) -> float:
    """Half the sum of squared whitened residuals of all factors at the present estimate (GTSAM's convention)."""
    return float(isam.getFactorsUnsafe().error(isam.calculateEstimate()))


def estimator_step(estimator: Estimator) -> Callable[[Step], object]:
    """The calls of one turn of the loop to an estimator."""

    def step(step: Step) -> object:
        estimator.predict(step.odometry)
        estimator.update(step.observations)
        return estimator.estimate()

    return step


def race(steps: Sequence[Step], *sides: Callable[[Step], object]) -> Array:
    """(steps, sides) milliseconds; the sides alternate in going first."""
    spent = np.zeros((len(steps), len(sides)))
    for k, step in enumerate(steps):
        for turn in range(len(sides)):
            side = (turn + k) % len(sides)
            began = perf_counter()
            sides[side](step)
            spent[k, side] = 1e3 * (perf_counter() - began)
    return spent


def smoother_figures(steps: Sequence[Step], config: ISAM2Config) -> tuple[Figures, Array]:
    """Step time and final graph error of `isam2` over those of direct calls, and its trajectory (K, 3)."""
    ours, bare = ISAM2(Pose(), np.zeros((3, 3)), config), ByHand(config)
    ms = race(steps, estimator_step(ours), bare.step).mean(axis=0)
    ratio = graph_error(ours._graph.isam) / graph_error(bare.isam)
    figures = {"step_ratio": float(ms[0] / ms[1]), "graph_error_ratio": ratio}
    return figures, ours.trajectory()


def figures(setting: Setting, seed: int) -> Figures:
    """`isam2` against direct calls of GTSAM, and the filters against the smoother; nothing is drawn."""
    steps = steps_of(read_graph(FILE))
    found, smoothed = smoother_figures(steps, preset("victoria").isam2)
    for name in ("ekf", "ekf-invariant"):
        estimator = make_estimator(name, Pose(), np.zeros((3, 3)))
        race(steps, estimator_step(estimator))
        gap = np.linalg.norm(estimator.trajectory()[:, :2] - smoothed[:, :2], axis=1)
        found[f"{name.replace('-', '_')}_rms_from_smoothed_m"] = float(np.sqrt(np.mean(gap**2)))
    return found
