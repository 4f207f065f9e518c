"""Laws of the posterior, for points and for walls: mean and joint covariance against batch least squares.

The noise is small, so that all estimators linearize at nearly the same place: their posteriors differ by about the
noise, relative to a lever of 1 m. A wrong covariance of an observation, a wrong Jacobian or a lost correlation changes
the posterior by a part of itself, whatever the noise.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np

from sixthsense.core.geometry import Array, Pose, wrap_angle
from sixthsense.core.landmarks import Kind, LandmarkId, Observation
from sixthsense.core.motion import Odometry
from sixthsense.slam.estimators import Estimator
from sixthsense.testing.batch import Log, Posterior, batch_posterior, jacobian, observation_jacobian, to_robot
from sixthsense.testing.estimation import fed, joint_state, make
from sixthsense.testing.laws import Laws

LAWS = Laws("statistics")

NOISE = 2.5e-4  # m and rad; GTSAM drops the correlations of a covariance whose off-diagonal is below 1e-9
TOLERANCE = 0.01  # of a sigma, and of a variance in any direction
# Away from the world's origin, where the offset of a wall depends strongly on its angle.
START = Pose(4.0, -3.0, 0.4)
START_COV = NOISE**2 * np.array([[2.0, 0.5, 0.3], [0.5, 3.0, -0.4], [0.3, -0.4, 1.0]])
MOTION = Odometry(Pose(0.6, 0.05, 0.25), NOISE**2 * np.array([[1.0, 0.2, 0.1], [0.2, 0.5, 0.1], [0.1, 0.1, 0.3]]))
POINT_COV = NOISE**2 * np.array([[1.0, 0.4], [0.4, 2.0]])
WALL_COV = NOISE**2 * np.array([[0.3, 0.2], [0.2, 1.0]])


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

    def sight(self, pose: Pose, ids: Sequence[LandmarkId], rng: np.random.Generator) -> dict[LandmarkId, Observation]:
        """Noisy observations of landmarks from a pose."""
        observations = {}
        for i in ids:
            wall = self.kinds[i] == Kind.WALL
            cov = WALL_COV if wall else POINT_COV
            z = to_robot(pose.array(), self.landmarks[i], wall) + np.linalg.cholesky(cov) @ rng.standard_normal(2)
            if wall:
                z[0] = wrap_angle(float(z[0]))
            observations[i] = Observation(self.kinds[i], z, cov, (-1.0, 1.0) if wall else (0.0, 0.0))
        return observations


_POINTS = np.array([[7.0, -1.5], [3.0, 0.0], [6.0, -5.0]])
# Normals towards the robot. The second wall's angle in the robot's frame passes a half turn on the drive.
_WALLS = np.array([[0.3, -3.0], [-2.3, -5.5], [1.7, -7.0]])
POINTS = World("points", _POINTS, (Kind.CORNER, Kind.END, Kind.CORNER))
WALLS = World("walls", _WALLS, (Kind.WALL,) * 3)
BOTH = World("points and walls", np.vstack([_POINTS[:2], _WALLS[:2]]), (*POINTS.kinds[:2], *WALLS.kinds[:2]))
WORLDS = (POINTS, WALLS, BOTH)


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
        true = true @ Pose.from_array(MOTION.motion.array() + error)
        ids = range(count - 1) if k < 2 else range(count) if k % 3 else [k % count, (k + 1) % count]
        log.append((MOTION, world.sight(true, list(ids), rng)))
    return log, true, batch_posterior(log, START, START_COV)


def driven(name: str, world: World, steps: int = 6) -> Estimator:
    """An estimator after the drive."""
    return fed(make(name, START, START_COV), drive(world, steps)[0])


def posterior(estimator: Estimator) -> tuple[Array, Array]:
    """(3 + 2n,) mean of pose and landmarks, and their covariance."""
    estimate, joint = joint_state(estimator)
    return np.append(estimate.pose.array(), estimate.landmarks), joint


def assert_agrees(estimator: Estimator, reference: Posterior) -> None:
    """Assert that mean and covariance agree with the reference in every direction, relative to its sigma there."""
    mean, cov = posterior(estimator)
    ids = estimator.estimate().ids.tolist()
    assert ids == reference.ids, f"found landmarks {ids}, expected {reference.ids}"
    root = np.linalg.cholesky(reference.cov)
    error = mean - reference.mean
    error[reference.angles] = wrap_angle(error[reference.angles])
    gap = float(np.linalg.norm(np.linalg.solve(root, error)))
    ratios = np.linalg.eigvalsh(np.linalg.solve(root, np.linalg.solve(root, cov).T))
    low, high = float(ratios[0]), float(ratios[-1])
    found = f"found {low:.3f} to {high:.3f} times the variance of the reference"
    assert low > 1.0 - TOLERANCE and high < 1.0 + TOLERANCE, f"{found}, allowed: 1 within {TOLERANCE}"
    assert gap < TOLERANCE, f"found a mean {gap:.3f} sigma from the reference, allowed: {TOLERANCE}"


def reference_of(estimator: Estimator) -> Posterior:
    """The estimator's own posterior as a reference."""
    estimate, joint = joint_state(estimator)
    angles = np.array([False, False, True, *(flag for wall in estimate.walls for flag in (bool(wall), False))])
    return Posterior(estimate.ids.tolist(), np.append(estimate.pose.array(), estimate.landmarks), joint, angles)


def _linearized(state: Array, observation: Observation) -> tuple[Array, Array, Array]:
    """Jacobian (2, 5) of an observation by pose and landmark, its innovation (2,), and the covariance (2, 2) of that.

    The error of a wall's observation is a turn about the place where direction and offset are independent, and a shift.
    """
    pose, landmark = state[:3], state[3:]
    if not observation.is_wall:
        H = observation_jacobian(pose, landmark, False)
        return H, observation.z - to_robot(pose, landmark, False), observation.cov
    alpha, d = (float(value) for value in observation.z)
    (var, mixed), (_, of_offset) = observation.cov.tolist()
    place = np.array([d * math.cos(alpha), d * math.sin(alpha)])
    place += mixed / var * np.array([-math.sin(alpha), math.cos(alpha)])

    def residual(x: Array) -> Array:
        line = to_robot(x[:3], x[3:], True)
        gap = math.cos(line[0]) * place[0] + math.sin(line[0]) * place[1] - line[1]
        return np.array([wrap_angle(alpha - float(line[0])), gap])

    return -jacobian(residual, state), residual(state), np.diag([var, of_offset - mixed**2 / var])


def corrected(prior: Posterior, observations: dict[LandmarkId, Observation]) -> Posterior:
    """A prior after observations of its landmarks, in information form: adds H^T R^-1 H, linearized at the prior."""
    information = np.linalg.inv(prior.cov)
    gradient = np.zeros(len(prior.mean))
    for i, observation in observations.items():
        k = prior.ids.index(i)
        at = np.append(np.arange(3), 3 + 2 * k + np.arange(2))
        H, innovation, cov = _linearized(prior.mean[at], observation)
        weight = np.linalg.inv(cov)
        information[np.ix_(at, at)] += H.T @ weight @ H
        gradient[at] += H.T @ weight @ innovation
    cov = np.linalg.inv(information)
    return Posterior(prior.ids, prior.mean + cov @ gradient, 0.5 * (cov + cov.T), prior.angles)


@LAWS.law_for(WORLDS)
def new_landmarks_have_the_joint_covariance_of_batch_least_squares(name: str, world: World) -> None:
    assert_agrees(driven(name, world, 1), drive(world, 1)[2])


@LAWS.law_for(WORLDS)
def the_first_update_gives_the_posterior_of_batch_least_squares(name: str, world: World) -> None:
    assert_agrees(driven(name, world, 2), drive(world, 2)[2])


@LAWS.law_for(WORLDS)
def a_drive_gives_the_posterior_of_batch_least_squares(name: str, world: World) -> None:
    assert_agrees(driven(name, world, 8), drive(world, 8)[2])


@LAWS.law_for(WORLDS)
def an_update_adds_the_information_of_its_observations(name: str, world: World) -> None:
    estimator = driven(name, world)
    estimator.predict(MOTION)
    prior = reference_of(estimator)
    true = drive(world, 6)[1] @ MOTION.motion
    observations = world.sight(true, [0, len(world.kinds) - 1], np.random.default_rng(1))
    estimator.update(observations)
    assert_agrees(estimator, corrected(prior, observations))


@LAWS.law_for(WORLDS)
def two_updates_with_one_observation_equal_one_with_half_its_covariance(name: str, world: World) -> None:
    true = drive(world, 6)[1]
    twice, once = driven(name, world), driven(name, world)
    observations = world.sight(true, [0, len(world.kinds) - 1], np.random.default_rng(2))
    for _ in range(2):
        twice.update(observations)
    once.update({i: Observation(s.kind, s.z, 0.5 * s.cov, s.extent) for i, s in observations.items()})
    assert_agrees(twice, reference_of(once))


@LAWS.law_for(WORLDS)
def the_order_of_two_updates_makes_no_difference(name: str, world: World) -> None:
    true, rng, last = drive(world, 6)[1], np.random.default_rng(3), len(world.kinds) - 1
    scans = [world.sight(true, ids, rng) for ids in ([0], [0, last])]
    one, two = driven(name, world), driven(name, world)
    for scan in scans:
        one.update(scan)
    for scan in reversed(scans):
        two.update(scan)
    assert_agrees(one, reference_of(two))
