"""Exercises on motion, filters and their covariance."""

from __future__ import annotations

import math

import numpy as np
from scipy.linalg import block_diag

from course.drawn import cov, points, pose
from course.exercise import Exercise, Judged
from sixthsense.core.geometry import Array, Pose, rotation
from sixthsense.core.landmarks import Kind, Observation, initialize_landmark, rotation_generator
from sixthsense.core.landmarks import predict as predicted_observations
from sixthsense.core.motion import compose_jacobians, rk4
from sixthsense.core.se2 import move_covariance
from sixthsense.evaluation.metrics import squares
from sixthsense.testing import check_estimator


def _motion_jacobian(at: Pose, motion: Pose) -> Array:
    return compose_jacobians(at.theta, motion)[0]


def _seen(at: Pose, landmark: Array) -> tuple[Array, Array, Array]:
    z, by_pose, by_landmark = predicted_observations(at, landmark[None], np.zeros(1, dtype=np.bool_))
    return z[0], by_pose[0], by_landmark[0]


def _measured(rng: np.random.Generator) -> tuple[Array, ...]:
    return rng.standard_normal(5), cov(rng, 5), rng.standard_normal((2, 5)), cov(rng, 2, 0.2), rng.standard_normal(2)


def _augmented(at: Pose, P: Array, z: Array, R: Array) -> tuple[Array, Array]:
    mean, by_pose, by_z = initialize_landmark(at, Observation(Kind.CORNER, z, R))
    cross = by_pose @ P[:3]
    return mean, np.block([[P, cross.T], [cross, cross[:, :3] @ by_pose.T + by_z @ R @ by_z.T]])


def _turned_back(at: Pose, R: Array) -> Array:
    """The covariance that is `R` once it is turned into the map's axes."""
    return np.asarray(rotation(at.theta).T @ R @ rotation(at.theta))


def _linearised(rng: np.random.Generator) -> tuple[Array, ...]:
    x, P, H, R, v = _measured(rng)
    return x, x + 0.5 * rng.standard_normal(5), P, H, R, v


def _near(rng: np.random.Generator) -> tuple[Pose, Array, Pose]:
    mean = pose(rng)
    return mean, cov(rng, 3, 0.2), mean @ Pose(*rng.normal(0.0, 0.8, 3))


def _particles(rng: np.random.Generator) -> tuple[Array, float]:
    weights = rng.uniform(0.1, 3.0, 9) ** 2
    return weights / weights.sum(), rng.uniform(0.1, 0.9)


EXERCISES: dict[str, Exercise | Judged] = {
    "arc": Exercise(
        ("x, y, theta",),
        lambda rng: (rng.uniform(0.3, 1.5), rng.uniform(0.4, 1.2), rng.uniform(0.5, 2.0)),
        lambda v, w, seconds: rk4(Pose(), v, w, seconds, 1e-2).array(),
        {
            "the heading turns on the way: this is Euler's step": lambda _, v, w, t: np.array([v * t, 0.0, w * t]),
            "the chord of an arc is shorter than the arc": lambda _, v, w, t: np.append(
                rotation(0.5 * w * t) @ [v * t, 0.0], w * t
            ),
        },
    ),
    "motion jacobian": Exercise(("Jacobian",), lambda rng: (pose(rng), pose(rng)), _motion_jacobian),
    "predict": Exercise(
        ("covariance",),
        lambda rng: (cov(rng, 7), _motion_jacobian(pose(rng), pose(rng)), cov(rng, 3, 0.1)),
        mistakes={
            "the correlations of pose and map change, too": lambda right, P, F, Q: np.block(
                [[right(P, F, Q)[:3, :3], P[:3, 3:]], [P[3:]]]
            )
        },
    ),
    "observation": Exercise(
        ("z", "by the pose", "by the landmark"),
        lambda rng: (pose(rng), points(rng, 1)[0]),
        _seen,
        {
            "the heading is left out of the Jacobian by the pose": lambda right, at, landmark: (
                right(at, landmark)[0],
                right(at, landmark)[1] * np.array([1.0, 1.0, 0.0]),
                right(at, landmark)[2],
            )
        },
    ),
    "gate": Exercise(
        ("squared distance",),
        lambda rng: (rng.standard_normal(2), rng.standard_normal((2, 5)), cov(rng, 5), cov(rng, 2, 0.1)),
        mistakes={"the covariance is not inverted": lambda _, v, H, P, R: v @ (H @ P @ H.T + R) @ v},
    ),
    "update": Exercise(
        ("mean", "covariance"),
        _measured,
        mistakes={
            "an observation makes the covariance smaller": lambda right, x, P, *z: (right(x, P, *z)[0], P),
        },
    ),
    "augment": Exercise(
        ("landmark", "covariance"),
        lambda rng: (pose(rng), cov(rng, 5), rng.uniform(-3.0, 3.0, 2), cov(rng, 2, 0.2)),
        _augmented,
        {
            "the landmark is correlated with pose and map: it was seen from that pose": lambda right, at, P, z, R: (
                right(at, P, z, R)[0],
                block_diag(P, right(at, P, z, R)[1][len(P) :, len(P) :]),
            ),
            "the noise of the observation is in the robot's axes and is not turned": lambda right, at, P, z, R: right(
                at, P, z, _turned_back(at, R)
            ),
        },
    ),
    "carried": Exercise(
        ("point", "covariance"),
        lambda rng: (pose(rng), cov(rng, 3), rng.uniform(-3.0, 3.0, 2), cov(rng, 2, 0.2)),
        mistakes={
            "the point's covariance is not turned into the map's axes": lambda right, at, P, p, R: right(
                at, P, p, _turned_back(at, R)
            ),
            "the heading's error moves the point, too": lambda right, at, P, p, R: right(
                at, block_diag(P[:2, :2], np.zeros((1, 1))), p, R
            ),
        },
    ),
    "EKF-SLAM": Judged(check_estimator),
    "turn of the world": Exercise(
        ("direction",),
        lambda rng: (pose(rng), points(rng, 3)),
        lambda at, landmarks: np.array([-at.y, at.x, 1.0, *np.ravel(rotation_generator(landmarks))]),
    ),
    "first estimates": Exercise(
        ("Jacobian",),
        lambda rng: (pose(rng), pose(rng)),
    ),
    "iterate": Exercise(
        ("mean",),
        _linearised,
        mistakes={
            "the prediction counts again at each iterate: start from it": lambda right, x, at, *z: (
                at + right(x, x, *z) - x
            ),
            "the innovation is of the iterate: lead it back to the prediction": lambda right, x, at, *z: right(
                x, x, *z
            ),
            "led back in the wrong direction": lambda right, x, at, *z: right(x, 2.0 * x - at, *z),
        },
    ),
    "forget": Exercise(
        ("covariance",),
        lambda rng: (cov(rng, 9), int(rng.integers(0, 3))),
        mistakes={
            "the landmark is taken as known exactly: forgetting adds no knowledge": lambda right, P, k: np.linalg.inv(
                right(np.linalg.inv(P), k)
            )
        },
    ),
    "exp": Exercise(
        ("x, y, theta",),
        lambda rng: (*rng.uniform(-2.0, 2.0, 2), rng.uniform(0.3, 2.5)),
        mistakes={
            "the turn bends the way: a twist is driven, not jumped": lambda _, v, u, w: np.array([v, u, w]),
        },
    ),
    "compound": Exercise(
        ("covariance",),
        lambda rng: (cov(rng, 3), pose(rng), cov(rng, 3)),
        lambda first_cov, step, step_cov: move_covariance(step.inverse().triple(), first_cov) + step_cov,
        {
            "the adjoint is transposed": lambda _, P, step, Q: (
                step.inverse().adjoint().T @ P @ step.inverse().adjoint() + Q
            )
        },
    ),
    "inside": Exercise(
        ("squared distance",),
        _near,
        mistakes={
            "the logarithm is missing: the motion from the mean is not yet in the tangent": lambda _, mean, P, at: (
                squares((mean.inverse() @ at).array()[None], P[None])[0]
            )
        },
    ),
    "weights": Exercise(
        ("weights",),
        lambda rng: (rng.uniform(-30.0, -2.0, 8) - 900.0,),
        mistakes={
            "all weights are zero: take off the largest logarithm before the exponential": lambda _, logs: np.full(
                len(logs), math.nan
            )
        },
    ),
    "resample": Exercise(
        ("indices",),
        _particles,
        mistakes={
            "all teeth lie at the same place": lambda _, w, u: np.repeat(np.searchsorted(np.cumsum(w), u), len(w)),
        },
    ),
    "effective particles": Exercise(("number",), lambda rng: (_particles(rng)[0],)),
}
