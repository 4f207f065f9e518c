"""A small world of points with simulated drives."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable
from functools import partial
from typing import Any

import numpy as np
from predicted import predict_points

from sixthsense.config import ISAM2Config
from sixthsense.core.geometry import Array, Pose, rotation, wrap_angle
from sixthsense.core.landmarks import Kind, LandmarkId, Observation
from sixthsense.core.motion import Odometry
from sixthsense.slam.estimators import Estimate, Estimator
from sixthsense.slam.estimators.ekf import EKF
from sixthsense.testing import estimators as worlds
from sixthsense.testing.estimators import CONVERGED, Part, fed, joint_state

__all__ = ["CONVERGED", "fed", "joint_state"]

POINTS = np.array([[3.0, 1.0], [-1.0, 2.0], [2.0, -2.0], [4.0, 3.0], [-2.0, -1.0]])
START = Pose(0.3, -0.2, 0.4)
START_COV = np.diag([0.02, 0.03, 0.01]) + 0.002
CONSISTENT = ("ekf-invariant", "isam2")


def broken(base: type = EKF, **calls: Callable[..., Any]) -> type:
    """A shipped part with other calls: functions of the part, of its own call, and of the arguments."""

    def method(name: str, other: Callable[..., Any]) -> Callable[..., Any]:
        return lambda own, *args: other(own, partial(getattr(base, name), own), *args)

    return type("Broken", (base,), {name: method(name, other) for name, other in calls.items()})


def make(part: Part, start: Pose = START, start_cov: Array = START_COV, isam2: ISAM2Config = CONVERGED) -> Estimator:
    """A new estimator at the start of the drives."""
    return worlds.make(part, start, start_cov, isam2)


def sight(
    pose: Pose, ids: Iterable[int], rng: np.random.Generator, sigma: float = 0.05, points: Array = POINTS
) -> dict[LandmarkId, Observation]:
    """Noisy observations of known points from a pose."""
    ids = list(ids)
    z, _, _ = predict_points(pose, points[ids])
    noise = rng.normal(0, sigma, z.shape)
    return {int(i): Observation(Kind.CORNER, z[k] + noise[k], np.eye(2) * sigma**2) for k, i in enumerate(ids)}


def step(x: float = 0.2, theta: float = 0.1, sigma: float = 0.02) -> Odometry:
    """A motion (x, 0, theta) with standard deviation sigma in m and sigma / 2 in rad."""
    return Odometry(Pose(x, 0.0, theta), np.diag([sigma**2, sigma**2, (0.5 * sigma) ** 2]))


def noisy(odometry: Odometry, rng: np.random.Generator) -> Pose:
    """A random true motion for the measurement `odometry` with its diagonal covariance."""
    error = np.sqrt(np.diag(odometry.cov)) * rng.standard_normal(3)
    return odometry.motion @ Pose.from_array(error)


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


def assert_same(one: tuple[Estimate, Array], two: tuple[Estimate, Array], atol: float = 0.0) -> None:
    """Assert that two results of `joint_state` agree; `atol` in m, rad and their squares."""
    (a, cov_a), (b, cov_b) = one, two
    assert a.ids.tolist() == b.ids.tolist()
    difference = np.append(a.pose.position - b.pose.position, wrap_angle(a.pose.theta - b.pose.theta))
    assert np.abs(difference).max() <= atol and np.abs(a.landmarks - b.landmarks).max(initial=0.0) <= atol
    assert np.abs(cov_a - cov_b).max() <= atol
