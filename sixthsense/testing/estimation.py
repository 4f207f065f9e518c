"""A small world of points with simulated drives, and the guarantees of each family of estimators."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from sixthsense.config import ISAM2Config
from sixthsense.config.parts import ESTIMATORS, options_class
from sixthsense.core.geometry import Array, Pose, rotation, wrap_angle
from sixthsense.core.landmarks import Kind, LandmarkId, Observation, initialize_point
from sixthsense.core.motion import Odometry
from sixthsense.slam.estimators import Estimate, Estimator, EstimatorFactory, make_estimator
from sixthsense.testing.sight import predict_points

POINTS = np.array([[3.0, 1.0], [-1.0, 2.0], [2.0, -2.0], [4.0, 3.0], [-2.0, -1.0]])
START = Pose(0.3, -0.2, 0.4)
START_COV = np.diag([0.02, 0.03, 0.01]) + 0.002
# The laws hold for the converged solution, and every match here is correct.
CONVERGED = ISAM2Config(relinearize_threshold=1e-9, iterations=5, undo_probability=1.0)


@dataclass(frozen=True)
class Family:
    """Differences between filters and the smoother in the laws."""

    polar: bool = False
    """Whether observations are used as bearing and range, without their bias."""
    rounding: float = 0.0
    """Largest difference of two results for one covariance, relative to its largest entry."""
    forgets_evidence: bool = False
    """Whether forgetting a landmark removes its information about the poses."""

    still: float = 0.0
    """Largest difference of two results between which nothing has changed."""
    step_rounding: float = 1e-9
    """Largest difference of a covariance after a motion noise of a micrometre; (m, rad) squared."""


FILTER, SMOOTHER = Family(), Family(polar=True, rounding=1e-9, forgets_evidence=True, step_rounding=1e-5)
OTHER = Family(rounding=1e-9, still=1e-9, step_rounding=1e-5)
"""of an estimator that is not shipped: it may solve anew where nothing has changed"""
FAMILIES = {name: FILTER for name in ("ekf", "ekf-fej", "ekf-oc", "ekf-invariant")} | {"isam2": SMOOTHER}
CONSISTENT = ("ekf-fej", "ekf-oc", "ekf-invariant", "isam2")


def family(name: str | EstimatorFactory) -> Family:
    """The family of an estimator; one that is not shipped counts as a filter that rounds."""
    return FAMILIES.get(name, OTHER) if isinstance(name, str) else OTHER


def make(
    name: str | EstimatorFactory, start: Pose = START, start_cov: Array = START_COV, isam2: ISAM2Config = CONVERGED
) -> Estimator:
    """A new estimator at a start with covariance `start_cov` (3, 3); the smoother is made with `isam2`."""
    factory = ESTIMATORS.load(name) if isinstance(name, str) else name
    return make_estimator(factory, start, start_cov, isam2 if options_class(factory) is ISAM2Config else None)


def as_used(name: str, observation: Observation) -> Observation:
    """The observation as the family uses it, in Cartesian coordinates."""
    if not family(name).polar:
        return observation
    bearing, distance, cov = observation.bearing_range()
    outward = rotation(bearing) @ np.array([[0.0, 1.0], [distance, 0.0]])  # by bearing, by range
    return Observation(observation.kind, outward[:, 1] * distance, outward @ cov @ outward.T)


def exact(name: str, z: Array, cov: Array) -> Observation:
    """The observation with covariance (2, 2) that the family uses as z (2,)."""
    observation = Observation(Kind.CORNER, z, cov)
    for _ in range(50):
        observation = Observation(Kind.CORNER, observation.z + z - as_used(name, observation).z, cov)
    assert np.allclose(as_used(name, observation).z, z, atol=1e-13)
    return observation


def sight(
    pose: Pose, ids: Iterable[int], rng: np.random.Generator, sigma: float = 0.05, points: Array = POINTS
) -> dict[LandmarkId, Observation]:
    """Noisy observations of known points from a pose."""
    ids = list(ids)
    z, _, _ = predict_points(pose, points[ids])
    noise = rng.normal(0, sigma, z.shape)
    return {int(i): Observation(Kind.CORNER, z[k] + noise[k], np.eye(2) * sigma**2) for k, i in enumerate(ids)}


def sight_exactly(
    name: str, pose: Pose, ids: Iterable[int], sigma: float = 0.05, points: Array = POINTS
) -> dict[LandmarkId, Observation]:
    """Observations without error and with covariance sigma^2 I."""
    ids = list(ids)
    z, _, _ = predict_points(pose, points[ids])
    return {int(i): exact(name, z[k], np.eye(2) * sigma**2) for k, i in enumerate(ids)}


def step(x: float = 0.2, theta: float = 0.1, sigma: float = 0.02) -> Odometry:
    """A motion (x, 0, theta) with standard deviation sigma in m and sigma / 2 in rad."""
    return Odometry(Pose(x, 0.0, theta), np.diag([sigma**2, sigma**2, (0.5 * sigma) ** 2]))


def noisy(odometry: Odometry, rng: np.random.Generator) -> Pose:
    """A random true motion for the measurement `odometry` with its diagonal covariance."""
    error = np.sqrt(np.diag(odometry.cov)) * rng.standard_normal(3)
    return Pose.from_array(odometry.motion.array() + error)


def rotated_covariance(theta: float, cov: Array) -> Array:
    """A joint covariance (3 + 2k, 3 + 2k) in a world rotated by `theta`."""
    turn = np.eye(len(cov))
    for k in (0, *range(3, len(cov), 2)):
        turn[k : k + 2, k : k + 2] = rotation(theta)
    return np.asarray(turn @ cov @ turn.T)


def driven(
    name: str,
    steps: int = 8,
    transform: Pose | None = None,
    isam2: ISAM2Config = CONVERGED,
    unseen: Collection[LandmarkId] = (),
) -> Estimator:
    """An estimator after a short drive in a world moved by `transform`; the landmarks `unseen` are not observed."""
    T = transform or Pose()
    estimator = make(name, T @ START, rotated_covariance(T.theta, START_COV), isam2)
    rng, true = np.random.default_rng(0), START
    for k in range(steps):
        estimator.predict(step())
        true = true @ step().motion
        seen = sight(true, [0, 1, 2] if k % 2 else [1, 3, 4], rng)
        estimator.update({i: observation for i, observation in seen.items() if i not in unseen})
    return estimator


def random_log(
    seed: int, points: Array, steps: int = 60, most: int = 8, sigma: float = 0.05
) -> list[tuple[Odometry, dict[LandmarkId, Observation]]]:
    """The inputs of a random drive, [(odometry, observations)], with up to `most` - 1 observations per step."""
    rng, true = np.random.default_rng(seed), START
    log: list[tuple[Odometry, dict[LandmarkId, Observation]]] = []
    for _ in range(steps):
        odometry = step(rng.uniform(-0.1, 0.4), rng.normal(0, 0.3))
        true = true @ noisy(odometry, rng)
        ids = rng.choice(len(points), rng.integers(0, most), replace=False).tolist()
        log.append((odometry, sight(true, ids, rng, sigma, points)))
    return log


def fed(estimator: Estimator, log: Iterable[tuple[Odometry, Mapping[LandmarkId, Observation]]]) -> Estimator:
    """The estimator after the inputs of a drive."""
    for odometry, observations in log:
        estimator.predict(odometry)
        estimator.update(observations)
    return estimator


def joint_state(estimator: Estimator) -> tuple[Estimate, Array]:
    """The estimate and the joint covariance of pose and all landmarks."""
    estimate = estimator.estimate()
    return estimate, estimator.joint_covariance(estimate.ids.tolist())


def assert_same(one: tuple[Estimate, Array], two: tuple[Estimate, Array], atol: float = 0.0) -> None:
    """Assert that two results of `joint_state` agree; `atol` in m, rad and their squares."""
    (a, cov_a), (b, cov_b) = one, two
    assert a.ids.tolist() == b.ids.tolist()
    difference = np.append(a.pose.position - b.pose.position, wrap_angle(a.pose.theta - b.pose.theta))
    assert np.abs(difference).max() <= atol and np.abs(a.landmarks - b.landmarks).max(initial=0.0) <= atol
    assert np.abs(cov_a - cov_b).max() <= atol


def expected_new_landmark(name: str, before: Estimate, observation: Observation) -> tuple[Array, Array, Array]:
    """Mean, covariance (2, 2) and covariance with the pose (2, 3) of a new landmark."""
    observation = as_used(name, observation)
    mean, by_pose, by_z = initialize_point(before.pose, observation.z)
    cov = by_pose @ before.pose_cov @ by_pose.T + by_z @ observation.cov @ by_z.T
    return mean, cov, by_pose @ before.pose_cov
