"""Small worlds of points and walls with simulated drives, on which the laws of estimators are checked.

The noise is small, so that all estimators linearize at nearly the same place: their posteriors differ by about the
noise, relative to a lever of 1 m. A wrong covariance of an observation, a wrong Jacobian or a lost correlation changes
the posterior by a part of itself, whatever the noise.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np

from sixthsense.config import ISAM2Config
from sixthsense.config.parts import ESTIMATORS, options_class
from sixthsense.core.geometry import Array, Pose, wrap_angle
from sixthsense.core.landmarks import Kind, LandmarkId, Observation
from sixthsense.core.motion import Odometry
from sixthsense.slam.estimators import Estimate, Estimator, EstimatorFactory, make_estimator
from sixthsense.testing.batch import Log, Posterior, batch_posterior, to_robot
from sixthsense.testing.laws import agree, at_most, equal

Part = str | EstimatorFactory
"""an estimator's name or class"""

NOISE = 2.5e-4  # m and rad; GTSAM drops the correlations of a covariance whose off-diagonal is below 1e-9
TOLERANCE = 0.01  # of a sigma, and of a variance in any direction
ROUNDING = 1e-6  # the same, where nothing but the order of computation differs
# Away from the world's origin, where the offset of a wall depends strongly on its angle.
START = Pose(4.0, -3.0, 0.4)
START_COV = NOISE**2 * np.array([[2.0, 0.5, 0.3], [0.5, 3.0, -0.4], [0.3, -0.4, 1.0]])
MOTION = Odometry(Pose(0.6, 0.05, 0.25), NOISE**2 * np.array([[1.0, 0.2, 0.1], [0.2, 0.5, 0.1], [0.1, 0.1, 0.3]]))
POINT_COV = NOISE**2 * np.array([[1.0, 0.4], [0.4, 2.0]])
WALL_COV = NOISE**2 * np.array([[0.3, 0.2], [0.2, 1.0]])
# The laws hold for the converged solution, and every match here is correct.
CONVERGED = ISAM2Config(relinearize_threshold=1e-9, iterations=5, undo_probability=1.0)


@dataclass(frozen=True, eq=False)
class World:
    """Landmarks around the start."""

    label: str
    landmarks: Array
    """(n, 2) x, y of a point, alpha, d of a wall, world frame; m and rad"""
    kinds: tuple[Kind, ...]
    """n"""

    @property
    def needs_walls(self) -> bool:
        """Whether one of the landmarks is a wall."""
        return Kind.WALL in self.kinds

    def observation(self, i: LandmarkId, z: Array, cov: Array | None = None) -> Observation:
        """An observation z (2,) of what landmark i is."""
        is_wall = self.kinds[i] == Kind.WALL
        cov = cov if cov is not None else WALL_COV if is_wall else POINT_COV
        return Observation(self.kinds[i], z, cov, (-1.0, 1.0) if is_wall else (0.0, 0.0))

    def sight(self, pose: Pose, ids: Iterable[LandmarkId], rng: np.random.Generator) -> dict[LandmarkId, Observation]:
        """Noisy observations of landmarks from a pose."""
        observations = {}
        for i in ids:
            is_wall = self.kinds[i] == Kind.WALL
            cov = WALL_COV if is_wall else POINT_COV
            z = to_robot(pose.array(), self.landmarks[i], is_wall) + np.linalg.cholesky(cov) @ rng.standard_normal(2)
            if is_wall:
                z[0] = wrap_angle(float(z[0]))
            observations[i] = self.observation(i, z)
        return observations


_POINTS = np.array([[7.0, -1.5], [3.0, 0.0], [6.0, -5.0]])
# Normals towards the robot. The second wall's angle in the robot's frame passes a half turn on the drive.
_WALLS = np.array([[0.3, -3.0], [-2.3, -5.5], [1.7, -7.0]])
POINTS = World("points", _POINTS, (Kind.CORNER, Kind.END, Kind.CORNER))
WALLS = World("walls", _WALLS, (Kind.WALL,) * 3)
BOTH = World("points and walls", np.vstack([_POINTS[:2], _WALLS[:2]]), (*POINTS.kinds[:2], *WALLS.kinds[:2]))
WORLDS = (POINTS, WALLS, BOTH)


def make(part: Part, start: Pose = START, start_cov: Array = START_COV, isam2: ISAM2Config = CONVERGED) -> Estimator:
    """A new estimator at a start with covariance `start_cov` (3, 3); the smoother is made with `isam2`."""
    factory = ESTIMATORS.load(part) if isinstance(part, str) else part
    return make_estimator(factory, start, start_cov, isam2 if options_class(factory) is ISAM2Config else None)


def fed(estimator: Estimator, log: Iterable[tuple[Odometry, Mapping[LandmarkId, Observation]]]) -> Estimator:
    """The estimator after the inputs of a drive."""
    for odometry, observations in log:
        estimator.predict(odometry)
        estimator.update(observations)
    return estimator


@cache
def drive(world: World, steps: int) -> tuple[Log, Pose, Posterior]:
    """The log of a drive of `steps` updates, the true pose at its end, and its posterior by batch least squares.

    The first two updates see all landmarks but the last, later ones two or all of them.
    """
    rng = np.random.default_rng(7)
    true = Pose.from_array(START.array() + np.linalg.cholesky(START_COV) @ rng.standard_normal(3))
    count, log = len(world.kinds), []
    for k in range(steps):
        error = np.linalg.cholesky(MOTION.cov) @ rng.standard_normal(3)
        true = true @ MOTION.motion @ Pose.from_array(error)
        ids = range(count - 1) if k < 2 else range(count) if k % 3 else [k % count, (k + 1) % count]
        log.append((MOTION, world.sight(true, list(ids), rng)))
    return log, true, batch_posterior(log, START, START_COV)


def driven(part: Part, world: World, steps: int = 6, unseen: Collection[LandmarkId] = ()) -> Estimator:
    """An estimator after the drive, on which the landmarks `unseen` are not observed."""
    log = [(motion, {i: s for i, s in seen.items() if i not in unseen}) for motion, seen in drive(world, steps)[0]]
    return fed(make(part), log)


def joint_state(estimator: Estimator) -> tuple[Estimate, Array]:
    """The estimate and the joint covariance of pose and all landmarks."""
    estimate = estimator.estimate()
    return estimate, estimator.joint_covariance(estimate.ids.tolist())


def state_of(estimator: Estimator) -> Posterior:
    """The estimator's own posterior, of pose and all landmarks."""
    estimate, joint = joint_state(estimator)
    angles = np.array([False, False, True, *(flag for wall in estimate.walls for flag in (bool(wall), False))])
    return Posterior(estimate.ids.tolist(), np.append(estimate.pose.array(), estimate.landmarks), joint, angles)


def rows_of(posterior: Posterior, ids: Sequence[LandmarkId]) -> list[int]:
    """Rows of the pose and of landmarks in a posterior."""
    return [0, 1, 2, *(3 + 2 * posterior.ids.index(i) + n for i in ids for n in (0, 1))]


def marginal(posterior: Posterior, ids: Sequence[LandmarkId]) -> Posterior:
    """A posterior of the pose and these landmarks alone."""
    rows = rows_of(posterior, ids)
    return Posterior([*ids], posterior.mean[rows], posterior.cov[np.ix_(rows, rows)], posterior.angles[rows])


def assert_agrees(found: Estimator | Posterior, reference: Posterior, tolerance: float = TOLERANCE) -> None:
    """Assert that mean and covariance agree with the reference in every direction, relative to its sigma there."""
    state = found if isinstance(found, Posterior) else state_of(found)
    equal("landmarks", state.ids, reference.ids)
    root = np.linalg.cholesky(reference.cov)
    error = state.mean - reference.mean
    error[reference.angles] = wrap_angle(error[reference.angles])
    ratios = np.linalg.eigvalsh(np.linalg.solve(root, np.linalg.solve(root, state.cov).T))
    low, high = float(ratios[0]), float(ratios[-1])
    text = f"covariance: found {low:.6g} to {high:.6g} times the variance of the reference"
    assert low > 1.0 - tolerance and high < 1.0 + tolerance, f"{text}, allowed: 1 within {tolerance:.3g}"
    at_most("mean, in sigma from the reference", float(np.linalg.norm(np.linalg.solve(root, error))), tolerance)


def assert_same(found: Estimator, reference: Posterior) -> None:
    """Assert that an estimator's posterior is the reference but for rounding."""
    assert_agrees(found, reference, ROUNDING)


def assert_unchanged(estimator: Estimator, before: Posterior, rows: Array) -> None:
    """Assert that posterior and trajectory (K, 3) of an estimator are those of before but for rounding."""
    assert_same(estimator, before)
    agree("trajectory", estimator.trajectory(), rows, atol=ROUNDING * NOISE)
