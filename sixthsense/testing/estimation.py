"""A small world of points, drives through it, and what each family of estimators promises."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from sixthsense.config import ISAM2Config
from sixthsense.core.geometry import Array, Pose, rotation, wrap_angle
from sixthsense.core.landmarks import Kind, LandmarkId, Sighting, initialize_point, predict_points
from sixthsense.core.motion import Odometry
from sixthsense.slam.estimators import Estimate, Estimator, make_estimator

POINTS = np.array([[3.0, 1.0], [-1.0, 2.0], [2.0, -2.0], [4.0, 3.0], [-2.0, -1.0]])
START = Pose(0.3, -0.2, 0.4)
START_COV = np.diag([0.02, 0.03, 0.01]) + 0.002
# The laws are the solution's: the smoother must have got there, and no sighting here is a wrong match.
CONVERGED = ISAM2Config(relinearize_threshold=1e-9, iterations=5, undo_probability=1.0)


@dataclass(frozen=True)
class Family:
    """Where filters and smoother keep a law differently."""

    polar: bool = False
    """Takes bearing and range, freed of their bias, for the relative position."""
    rounding: float = 0.0
    """By how much two answers about the same covariance may differ, in terms of its largest entry."""
    takes_back: bool = False
    """Forgetting a landmark takes back what it has told of the poses."""

    step_rounding: float = 1e-9
    """By how much a covariance may differ where one motion of a micrometre lies between; (m, rad) squared."""


FILTER, SMOOTHER = Family(), Family(polar=True, rounding=1e-9, takes_back=True, step_rounding=1e-5)
FAMILIES = {name: FILTER for name in ("ekf", "ekf-fej", "ekf-oc", "ekf-invariant")} | {"isam2": SMOOTHER}
CONSISTENT = ("ekf-fej", "ekf-oc", "ekf-invariant", "isam2")


def family(name: str) -> Family:
    """Of the estimator of that name; one of a user's own is a filter."""
    return FAMILIES.get(name, FILTER)


def make(
    name: str, start: Pose = START, start_cov: Array = START_COV, isam2: ISAM2Config | None = CONVERGED
) -> Estimator:
    """The estimator of that name, at a start known to `start_cov` (3, 3)."""
    return make_estimator(name, start, start_cov, isam2)


def taken_in(name: str, sighting: Sighting) -> Sighting:
    """The sighting as the family takes it in, in Cartesian terms."""
    if not family(name).polar:
        return sighting
    bearing, distance, cov = sighting.bearing_range()
    outward = rotation(bearing) @ np.array([[0.0, 1.0], [distance, 0.0]])  # by bearing, by range
    return Sighting(sighting.kind, outward[:, 1] * distance, outward @ cov @ outward.T)


def exact(name: str, z: Array, cov: Array) -> Sighting:
    """The sighting of covariance (2, 2) whose mean is z (2,) as the family takes it in."""
    sighting = Sighting(Kind.CORNER, z, cov)
    for _ in range(50):
        sighting = Sighting(Kind.CORNER, sighting.z + z - taken_in(name, sighting).z, cov)
    assert np.allclose(taken_in(name, sighting).z, z, atol=1e-13)
    return sighting


def sight(
    pose: Pose, ids: Iterable[int], rng: np.random.Generator, sigma: float = 0.05, points: Array = POINTS
) -> dict[LandmarkId, Sighting]:
    """Noisy sightings of known points from a pose."""
    ids = list(ids)
    z, _, _ = predict_points(pose, points[ids])
    noise = rng.normal(0, sigma, z.shape)
    return {int(i): Sighting(Kind.CORNER, z[k] + noise[k], np.eye(2) * sigma**2) for k, i in enumerate(ids)}


def sight_exactly(
    name: str, pose: Pose, ids: Iterable[int], sigma: float = 0.05, points: Array = POINTS
) -> dict[LandmarkId, Sighting]:
    """Sightings without an error, whatever they claim."""
    ids = list(ids)
    z, _, _ = predict_points(pose, points[ids])
    return {int(i): exact(name, z[k], np.eye(2) * sigma**2) for k, i in enumerate(ids)}


def step(x: float = 0.2, theta: float = 0.1, sigma: float = 0.02) -> Odometry:
    """A motion (x, 0, theta) known to sigma in m, and half of it in rad."""
    return Odometry(Pose(x, 0.0, theta), np.diag([sigma**2, sigma**2, (0.5 * sigma) ** 2]))


def noisy(odometry: Odometry, rng: np.random.Generator) -> Pose:
    """A true motion of which `odometry`, with its diagonal covariance, is the measurement."""
    error = np.sqrt(np.diag(odometry.cov)) * rng.standard_normal(3)
    return Pose.from_array(odometry.motion.array() + error)


def turned_pose_cov(theta: float, cov: Array) -> Array:
    """A joint covariance (3 + 2k, 3 + 2k) in a world turned by `theta`."""
    turn = np.eye(len(cov))
    for k in (0, *range(3, len(cov), 2)):
        turn[k : k + 2, k : k + 2] = rotation(theta)
    return np.asarray(turn @ cov @ turn.T)


def driven(
    name: str,
    steps: int = 8,
    transform: Pose | None = None,
    isam2: ISAM2Config | None = CONVERGED,
    unseen: Collection[LandmarkId] = (),
) -> Estimator:
    """An estimator after a short drive with sightings but of the `unseen`, the world moved by `transform`."""
    T = transform or Pose()
    estimator = make(name, T @ START, turned_pose_cov(T.theta, START_COV), isam2)
    rng, true = np.random.default_rng(0), START
    for k in range(steps):
        estimator.predict(step())
        true = true @ step().motion
        seen = sight(true, [0, 1, 2] if k % 2 else [1, 3, 4], rng)
        estimator.update({i: sighting for i, sighting in seen.items() if i not in unseen})
    return estimator


def random_log(
    seed: int, points: Array, steps: int = 60, most: int = 8, sigma: float = 0.05
) -> list[tuple[Odometry, dict[LandmarkId, Sighting]]]:
    """A drive as the estimator gets it, [(odometry, sightings)], with up to `most` - 1 sightings per step."""
    rng, true = np.random.default_rng(seed), START
    log: list[tuple[Odometry, dict[LandmarkId, Sighting]]] = []
    for _ in range(steps):
        odometry = step(rng.uniform(-0.1, 0.4), rng.normal(0, 0.3))
        true = true @ noisy(odometry, rng)
        ids = rng.choice(len(points), rng.integers(0, most), replace=False).tolist()
        log.append((odometry, sight(true, ids, rng, sigma, points)))
    return log


def fed(estimator: Estimator, log: Iterable[tuple[Odometry, Mapping[LandmarkId, Sighting]]]) -> Estimator:
    """The estimator after a drive."""
    for odometry, sightings in log:
        estimator.predict(odometry)
        estimator.update(sightings)
    return estimator


def everything(estimator: Estimator) -> tuple[Estimate, Array]:
    """What it believes, and the joint covariance of all of it."""
    estimate = estimator.estimate()
    return estimate, estimator.joint_covariance(estimate.ids.tolist())


def assert_same(one: tuple[Estimate, Array], two: tuple[Estimate, Array], atol: float = 0.0) -> None:
    """Two answers of `everything` agree; `atol` in m, rad and their squares."""
    (a, cov_a), (b, cov_b) = one, two
    assert a.ids.tolist() == b.ids.tolist()
    difference = np.append(a.pose.position - b.pose.position, wrap_angle(a.pose.theta - b.pose.theta))
    assert np.abs(difference).max() <= atol and np.abs(a.landmarks - b.landmarks).max(initial=0.0) <= atol
    assert np.abs(cov_a - cov_b).max() <= atol


def expected_birth(name: str, before: Estimate, sighting: Sighting) -> tuple[Array, Array, Array]:
    """Mean, covariance (2, 2) and covariance with the pose (2, 3) that a landmark is born with."""
    sighting = taken_in(name, sighting)
    mean, by_pose, by_z = initialize_point(before.pose, sighting.z)
    cov = by_pose @ before.pose_cov @ by_pose.T + by_z @ sighting.cov @ by_z.T
    return mean, cov, by_pose @ before.pose_cov
