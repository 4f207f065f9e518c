"""Exercises on motion, filters and their covariance."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from course.drawn import cov, points, pose
from course.exercise import Exercise, Judged, Mistakes
from sixthsense.core.geometry import Array, Pose, rotation
from sixthsense.core.landmarks import Kind, Observation, initialize_landmark, rotation_generator
from sixthsense.core.landmarks import predict as predicted_observations
from sixthsense.core.motion import compose_jacobians, rk4
from sixthsense.core.se2 import move_covariance
from sixthsense.evaluation.metrics import squares
from sixthsense.testing import check_estimator


def _motion_jacobian(at: Pose, motion: Pose) -> Array:
    return compose_jacobians(at.theta, motion)[0]


def _predicted(P: Array, phi: Array, Q: Array) -> Array:
    F, noise = np.eye(len(P)), np.zeros_like(P)
    F[:3, :3], noise[:3, :3] = phi, Q
    return np.asarray(F @ P @ F.T + noise)


def _own_block_alone(P: Array, phi: Array, Q: Array) -> Array:
    made = P.copy()
    made[:3, :3] = phi @ P[:3, :3] @ phi.T + Q
    return made


def _seen(at: Pose, landmark: Array) -> tuple[Array, Array, Array]:
    z, by_pose, by_landmark = predicted_observations(at, landmark[None], np.zeros(1, dtype=np.bool_))
    return z[0], by_pose[0], by_landmark[0]


def _without_heading(at: Pose, landmark: Array) -> tuple[Array, Array, Array]:
    z, by_pose, by_landmark = _seen(at, landmark)
    return z, by_pose * np.array([1.0, 1.0, 0.0]), by_landmark


def _gate(v: Array, H: Array, P: Array, R: Array) -> float:
    return float(squares(v[None], (H @ P @ H.T + R)[None])[0])


def _measured(rng: np.random.Generator) -> tuple[Array, ...]:
    return rng.standard_normal(5), cov(rng, 5), rng.standard_normal((2, 5)), cov(rng, 2, 0.2), rng.standard_normal(2)


def _update(x: Array, P: Array, H: Array, R: Array, v: Array) -> tuple[Array, Array]:
    K = P @ H.T @ np.linalg.inv(H @ P @ H.T + R)
    return x + K @ v, P - K @ H @ P


def _augmented(at: Pose, P: Array, z: Array, R: Array) -> tuple[Array, Array]:
    mean, by_pose, by_z = initialize_landmark(at, Observation(Kind.CORNER, z, R))
    cross = by_pose @ P[:3]
    return mean, np.block([[P, cross.T], [cross, cross[:, :3] @ by_pose.T + by_z @ R @ by_z.T]])


def _uncorrelated(at: Pose, P: Array, z: Array, R: Array) -> tuple[Array, Array]:
    mean, made = _augmented(at, P, z, R)
    made[: len(P), len(P) :] = made[len(P) :, : len(P)] = 0.0
    return mean, made


def _noise_not_turned(at: Pose, P: Array, z: Array, R: Array) -> tuple[Array, Array]:
    mean, made = _augmented(at, P, z, R)
    made[len(P) :, len(P) :] += R - rotation(at.theta) @ R @ rotation(at.theta).T
    return mean, made


def _carried(at: Pose, P: Array, point: Array, R: Array) -> tuple[Array, Array]:
    mean, made = _augmented(at, P, point, R)
    return mean, made[3:, 3:]


def _carried_not_turned(at: Pose, P: Array, point: Array, R: Array) -> tuple[Array, Array]:
    mean, made = _noise_not_turned(at, P, point, R)
    return mean, made[3:, 3:]


def _turn_of_world(at: Pose, landmarks: Array) -> Array:
    return np.array([-at.y, at.x, 1.0, *np.ravel(rotation_generator(landmarks))])


def _iterate(x: Array, at: Array, P: Array, H: Array, R: Array, v: Array) -> Array:
    return _update(x, P, H, R, v - H @ (x - at))[0]


def _linearised(rng: np.random.Generator) -> tuple[Array, ...]:
    x, P, H, R, v = _measured(rng)
    return x, x + 0.5 * rng.standard_normal(5), P, H, R, v


def _without(P: Array, slot: int) -> Array:
    keep = np.delete(np.arange(len(P)), [3 + 2 * slot, 4 + 2 * slot])
    return np.asarray(P[np.ix_(keep, keep)])


def _exp(v: float, u: float, w: float) -> Array:
    ahead, aside = rk4(Pose(), v, w, 1.0, 1e-2), rk4(Pose(theta=0.5 * math.pi), u, w, 1.0, 1e-2)
    return np.array([*(ahead.position + aside.position), w])


def _squared(mean: Pose, P: Array, at: Pose) -> float:
    local = mean.inverse() @ at
    a, b = math.sin(local.theta) / local.theta, (1.0 - math.cos(local.theta)) / local.theta
    xi = np.append(np.linalg.solve([[a, -b], [b, a]], local.position), local.theta)
    return float(squares(xi[None], P[None])[0])


def _near(rng: np.random.Generator) -> tuple[Pose, Array, Pose]:
    mean = pose(rng)
    return mean, cov(rng, 3, 0.2), mean @ Pose(*rng.normal(0.0, 0.8, 3))


def _by_coordinates(mean: Pose, P: Array, at: Pose) -> float:
    off = at.array() - mean.array()
    off[2] = math.remainder(off[2], 2.0 * math.pi)
    return float(off @ np.linalg.solve(P, off))


def _by_relative(mean: Pose, P: Array, at: Pose) -> float:
    off = (mean.inverse() @ at).array()
    return float(off @ np.linalg.solve(P, off))


def _weights(logs: Array) -> Array:
    made = np.exp(logs - logs.max())
    return np.asarray(made / made.sum())


def _resampled(weights: Array, u: float) -> NDArray[np.int64]:
    at = (u + np.arange(len(weights))) / len(weights)
    return np.minimum(np.searchsorted(np.cumsum(weights), at), len(weights) - 1)


def _particles(rng: np.random.Generator) -> tuple[Array, float]:
    weights = rng.uniform(0.1, 3.0, 9) ** 2
    return weights / weights.sum(), rng.uniform(0.1, 0.9)


def _arc(v: float, w: float, t: float) -> Array:
    return rk4(Pose(), v, w, t, 1e-2).array()


EXERCISES: dict[str, Exercise | Judged] = {
    "arc": Exercise(
        ("x, y, theta",), lambda rng: (rng.uniform(0.3, 1.5), rng.uniform(0.4, 1.2), rng.uniform(0.5, 2.0)), _arc
    ),
    "motion jacobian": Exercise(("Jacobian",), lambda rng: (pose(rng), pose(rng)), _motion_jacobian),
    "predict": Exercise(
        ("covariance",), lambda rng: (cov(rng, 7), _motion_jacobian(pose(rng), pose(rng)), cov(rng, 3, 0.1)), _predicted
    ),
    "observation": Exercise(("z", "by the pose", "by the landmark"), lambda rng: (pose(rng), points(rng, 1)[0]), _seen),
    "gate": Exercise(
        ("squared distance",),
        lambda rng: (rng.standard_normal(2), rng.standard_normal((2, 5)), cov(rng, 5), cov(rng, 2, 0.1)),
        _gate,
    ),
    "update": Exercise(("mean", "covariance"), _measured, _update),
    "augment": Exercise(
        ("landmark", "covariance"),
        lambda rng: (pose(rng), cov(rng, 5), rng.uniform(-3.0, 3.0, 2), cov(rng, 2, 0.2)),
        _augmented,
    ),
    "carried": Exercise(
        ("point", "covariance"),
        lambda rng: (pose(rng), cov(rng, 3), rng.uniform(-3.0, 3.0, 2), cov(rng, 2, 0.2)),
        _carried,
    ),
    "EKF-SLAM": Judged(check_estimator),
    "turn of the world": Exercise(("direction",), lambda rng: (pose(rng), points(rng, 3)), _turn_of_world),
    "first estimates": Exercise(
        ("Jacobian",),
        lambda rng: (pose(rng), pose(rng)),
        lambda before, after: _motion_jacobian(Pose(), Pose(*after.position - before.position, 0.0)),
    ),
    "iterate": Exercise(("mean",), _linearised, _iterate),
    "forget": Exercise(("covariance",), lambda rng: (cov(rng, 9), int(rng.integers(0, 3))), _without),
    "exp": Exercise(("x, y, theta",), lambda rng: (*rng.uniform(-2.0, 2.0, 2), rng.uniform(0.3, 2.5)), _exp),
    "compound": Exercise(
        ("covariance",),
        lambda rng: (cov(rng, 3), pose(rng), cov(rng, 3)),
        lambda first_cov, step, step_cov: move_covariance(step.inverse().triple(), first_cov) + step_cov,
    ),
    "inside": Exercise(("squared distance",), _near, _squared),
    "weights": Exercise(("weights",), lambda rng: (rng.uniform(-30.0, -2.0, 8) - 900.0,), _weights),
    "resample": Exercise(("indices",), _particles, _resampled),
    "effective particles": Exercise(
        ("number",), lambda rng: (_particles(rng)[0],), lambda weights: 1.0 / np.sum(weights**2)
    ),
}

MISTAKES: Mistakes = {
    "arc": {
        "the heading turns on the way: this is Euler's step": lambda v, w, t: np.array([v * t, 0.0, w * t]),
        "the whole way is driven at the last heading": lambda v, w, t: np.append(rotation(w * t) @ [v * t, 0.0], w * t),
        "the chord of an arc is shorter than the arc": lambda v, w, t: np.append(
            rotation(0.5 * w * t) @ [v * t, 0.0], w * t
        ),
    },
    "predict": {"the correlations of pose and map change, too": _own_block_alone},
    "observation": {"the heading is left out of the Jacobian by the pose": _without_heading},
    "gate": {"the covariance is not inverted": lambda v, H, P, R: v @ (H @ P @ H.T + R) @ v},
    "update": {
        "an observation makes the covariance smaller": lambda x, P, H, R, v: (_update(x, P, H, R, v)[0], P),
        "the covariance grows: the gain has the wrong sign there": lambda x, P, H, R, v: (
            _update(x, P, H, R, v)[0],
            2.0 * P - _update(x, P, H, R, v)[1],
        ),
    },
    "augment": {
        "the landmark is correlated with pose and map: it was seen from that pose": _uncorrelated,
        "the noise of the observation is in the robot's axes and is not turned": _noise_not_turned,
    },
    "carried": {
        "the point's covariance is not turned into the map's axes": _carried_not_turned,
        "the heading's error moves the point, too": lambda a, P, p, R: (
            _carried(a, P, p, R)[0],
            P[:2, :2] + _carried(a, 0.0 * P, p, R)[1],
        ),
    },
    "turn of the world": {
        "the world turns the other way, and the heading does not": lambda a, L: np.where(
            np.arange(3 + 2 * len(L)) == 2, 1.0, -_turn_of_world(a, L)
        )
    },
    "first estimates": {
        "the difference of the positions is already in the world's axes": lambda a, b: _motion_jacobian(
            a, Pose(*b.position - a.position, 0.0)
        )
    },
    "iterate": {
        "the prediction counts again at each iterate: start from it": lambda x, at, P, H, R, v: (
            at + _update(x, P, H, R, v)[0] - x
        ),
        "the innovation is of the iterate: lead it back to the prediction": lambda x, at, P, H, R, v: _update(
            x, P, H, R, v
        )[0],
        "led back in the wrong direction": lambda x, at, P, H, R, v: _iterate(x, 2.0 * x - at, P, H, R, v),
    },
    "forget": {
        "this is the covariance if the landmark were known exactly: forgetting adds no knowledge": lambda P, k: (
            np.linalg.inv(_without(np.linalg.inv(P), k))
        ),
        "the pose has three numbers before the first landmark": lambda P, k: np.delete(
            np.delete(P, [2 * k, 2 * k + 1], 0), [2 * k, 2 * k + 1], 1
        ),
    },
    "exp": {
        "the turn bends the way: a twist is driven, not jumped": lambda v, u, w: np.array([v, u, w]),
        "it bends the other way": lambda v, u, w: _exp(v, u, -w) * np.array([1.0, 1.0, -1.0]),
        "all of the way has the last heading": lambda v, u, w: np.append(rotation(w) @ [v, u], w),
    },
    "compound": {"the adjoint is transposed": lambda P, s, Q: s.inverse().adjoint().T @ P @ s.inverse().adjoint() + Q},
    "inside": {
        "the difference is of coordinates: take it in the tangent at the mean": _by_coordinates,
        "the logarithm is missing: the motion from the mean is not yet in the tangent": _by_relative,
    },
    "weights": {
        "all weights are zero: take off the largest logarithm before the exponential": lambda logs: (
            np.exp(logs) / np.exp(logs).sum()
        ),
        "the weights do not add up to one": lambda logs: np.exp(logs - logs.max()),
    },
    "resample": {
        "all teeth lie at the same place": lambda w, u: np.repeat(np.searchsorted(np.cumsum(w), u), len(w)),
        "each particle is kept once, whatever its weight": lambda w, u: np.arange(len(w)),
        "the weights are not accumulated": lambda w, u: np.searchsorted(np.sort(w), (u + np.arange(len(w))) / len(w)),
    },
    "effective particles": {"this is one over the largest weight": lambda w: 1.0 / w.max()},
}
