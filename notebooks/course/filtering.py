"""Exercises on motion, filters and their covariance."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from course.drawn import cov, points, pose
from course.exercise import Exercise, Judged, Mistake, verdict
from sixthsense.core.geometry import Array, Pose, rotation


def _arc(v: float, w: float, t: float) -> Array:
    return np.array([v / w * math.sin(w * t), v / w * (1.0 - math.cos(w * t)), w * t])


def _motion_jacobian(at: Pose, motion: Pose) -> Array:
    x, y = rotation(at.theta) @ motion.position
    return np.array([[1.0, 0.0, -y], [0.0, 1.0, x], [0.0, 0.0, 1.0]])


def _joint(rng: np.random.Generator) -> tuple[Array, Array, Array]:
    return cov(rng, 7), _motion_jacobian(pose(rng), pose(rng)), cov(rng, 3, 0.1)


def _predicted(P: Array, phi: Array, Q: Array) -> Array:
    F = np.eye(len(P))
    F[:3, :3] = phi
    made = F @ P @ F.T
    made[:3, :3] += Q
    return np.asarray(made)


def _own_block_alone(P: Array, phi: Array, Q: Array) -> Array:
    made = P.copy()
    made[:3, :3] = phi @ P[:3, :3] @ phi.T + Q
    return made


def _seen(at: Pose, landmark: Array) -> tuple[Array, Array, Array]:
    C = rotation(at.theta)
    z = C.T @ (landmark - at.position)
    return z, np.column_stack([-C.T, [z[1], -z[0]]]), C.T


def _seen_turned(at: Pose, landmark: Array) -> tuple[Array, Array, Array]:
    return _seen(Pose(at.x, at.y, -at.theta), landmark)


def _without_heading(at: Pose, landmark: Array) -> tuple[Array, Array, Array]:
    z, by_pose, by_landmark = _seen(at, landmark)
    return z, by_pose * np.array([1.0, 1.0, 0.0]), by_landmark


def _signs_turned(at: Pose, landmark: Array) -> tuple[Array, Array, Array]:
    z, by_pose, by_landmark = _seen(at, landmark)
    return z, -by_pose, by_landmark


def _innovation(rng: np.random.Generator) -> tuple[Array, ...]:
    return rng.standard_normal(2), rng.standard_normal((2, 5)), cov(rng, 5), cov(rng, 2, 0.1)


def _gate(v: Array, H: Array, P: Array, R: Array) -> float:
    return float(v @ np.linalg.solve(H @ P @ H.T + R, v))


def _measured(rng: np.random.Generator) -> tuple[Array, ...]:
    return rng.standard_normal(5), cov(rng, 5), rng.standard_normal((2, 5)), cov(rng, 2, 0.2), rng.standard_normal(2)


def _update(x: Array, P: Array, H: Array, R: Array, v: Array) -> tuple[Array, Array]:
    K = P @ H.T @ np.linalg.inv(H @ P @ H.T + R)
    return x + K @ v, P - K @ H @ P


def _augmented(at: Pose, P: Array, z: Array, R: Array) -> tuple[Array, Array]:
    C = rotation(at.theta)
    offset = C @ z
    G = np.zeros((2, len(P)))
    G[:, :3] = [[1.0, 0.0, -offset[1]], [0.0, 1.0, offset[0]]]
    cross = G @ P
    return at.position + offset, np.block([[P, cross.T], [cross, cross @ G.T + C @ R @ C.T]])


def _first_seen(rng: np.random.Generator) -> tuple[Any, ...]:
    return pose(rng), cov(rng, 5), rng.uniform(-3.0, 3.0, 2), cov(rng, 2, 0.2)


def _uncorrelated(at: Pose, P: Array, z: Array, R: Array) -> tuple[Array, Array]:
    mean, made = _augmented(at, P, z, R)
    made[: len(P), len(P) :] = made[len(P) :, : len(P)] = 0.0
    return mean, made


def _noise_not_turned(at: Pose, P: Array, z: Array, R: Array) -> tuple[Array, Array]:
    mean, made = _augmented(at, P, z, R)
    C = rotation(at.theta)
    made[len(P) :, len(P) :] += R - C @ R @ C.T
    return mean, made


def _carried(at: Pose, P: Array, point: Array, R: Array) -> tuple[Array, Array]:
    mean, made = _augmented(at, P, point, R)
    return mean, made[3:, 3:]


def _turn_of_world(at: Pose, landmarks: Array) -> Array:
    turned = [(-y, x) for x, y in landmarks]
    return np.array([-at.y, at.x, 1.0, *np.ravel(turned)])


def _iterate(x: Array, at: Array, P: Array, H: Array, R: Array, v: Array) -> Array:
    K = P @ H.T @ np.linalg.inv(H @ P @ H.T + R)
    return np.asarray(x + K @ (v - H @ (x - at)))


def _linearised(rng: np.random.Generator) -> tuple[Array, ...]:
    x, P, H, R, v = _measured(rng)
    return x, x + 0.5 * rng.standard_normal(5), P, H, R, v


def _without(P: Array, slot: int) -> Array:
    keep = np.delete(np.arange(len(P)), [3 + 2 * slot, 4 + 2 * slot])
    return np.asarray(P[np.ix_(keep, keep)])


def _held(P: Array, slot: int) -> Array:
    """Conditioned: as if the landmark were known exactly."""
    information = _without(np.asarray(np.linalg.inv(P), dtype=np.float64), slot)
    return np.asarray(np.linalg.inv(information))


def _exp(v: float, u: float, w: float) -> Array:
    a, b = math.sin(w) / w, (1.0 - math.cos(w)) / w
    return np.array([a * v - b * u, b * v + a * u, w])


def _log(at: Pose) -> Array:
    w = at.theta
    a, b = math.sin(w) / w, (1.0 - math.cos(w)) / w
    x, y = np.linalg.solve([[a, -b], [b, a]], at.position)
    return np.array([x, y, w])


def _compound(first_cov: Array, step: Pose, step_cov: Array) -> Array:
    A = step.inverse().adjoint()
    return np.asarray(A @ first_cov @ A.T + step_cov)


def _squared(mean: Pose, P: Array, at: Pose) -> float:
    xi = _log(mean.inverse() @ at)
    return float(xi @ np.linalg.solve(P, xi))


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


def _plain_weights(logs: Array) -> Array:
    made = np.exp(logs)
    with np.errstate(invalid="ignore"):
        return np.asarray(made / made.sum())


def _resampled(weights: Array, u: float) -> NDArray[np.int64]:
    at = (u + np.arange(len(weights))) / len(weights)
    return np.minimum(np.searchsorted(np.cumsum(weights), at), len(weights) - 1)


def _particles(rng: np.random.Generator) -> tuple[Array, float]:
    weights = rng.uniform(0.1, 3.0, 9) ** 2
    return weights / weights.sum(), rng.uniform(0.1, 0.9)


def _judge_estimator(estimator: Any) -> str:
    from sixthsense.testing import check_estimator

    return verdict(check_estimator(estimator))


EXERCISES = (
    Exercise(
        "arc",
        ("x, y, theta",),
        lambda rng: (rng.uniform(0.3, 1.5), rng.uniform(0.4, 1.2), rng.uniform(0.5, 2.0)),
        _arc,
        (
            Mistake(
                "the heading turns on the way: this is Euler's step", lambda v, w, t: np.array([v * t, 0.0, w * t])
            ),
            Mistake(
                "the whole way is driven at the last heading",
                lambda v, w, t: np.array([v * t * math.cos(w * t), v * t * math.sin(w * t), w * t]),
            ),
            Mistake(
                "the chord of an arc is shorter than the arc",
                lambda v, w, t: np.array([v * t * math.cos(0.5 * w * t), v * t * math.sin(0.5 * w * t), w * t]),
            ),
        ),
    ),
    Exercise(
        "motion jacobian",
        ("Jacobian",),
        lambda rng: (pose(rng), pose(rng)),
        _motion_jacobian,
        (
            Mistake(
                "the last column has the wrong sign: which way does a turn to the left move the end?",
                lambda a, m: 2.0 * np.eye(3) - _motion_jacobian(a, m),
            ),
            Mistake("the motion is not turned into the world's axes", lambda a, m: _motion_jacobian(Pose(), m)),
            Mistake("rows are results, columns what they are derived by", lambda a, m: _motion_jacobian(a, m).T),
            Mistake("the heading moves the end of the motion, too", lambda a, m: np.eye(3)),
        ),
    ),
    Exercise(
        "predict",
        ("covariance",),
        _joint,
        _predicted,
        (
            Mistake("the correlations of pose and map do not change, but the pose does", _own_block_alone),
            Mistake("the Jacobian is transposed", lambda P, phi, Q: _predicted(P, phi.T, Q)),
            Mistake("the noise of the motion is missing", lambda P, phi, Q: _predicted(P, phi, 0.0 * Q)),
            Mistake(
                "the noise of the motion goes to the pose alone, the map does not move",
                lambda P, phi, Q: _predicted(P, phi, 0.0 * Q) + np.pad(Q, (0, len(P) - 3), mode="wrap"),
            ),
        ),
    ),
    Exercise(
        "observation",
        ("z", "by the pose", "by the landmark"),
        lambda rng: (pose(rng), points(rng, 1)[0]),
        _seen,
        (
            Mistake("the landmark is turned the wrong way: from the world's axes into the robot's", _seen_turned),
            Mistake("the heading is left out of the Jacobian by the pose", _without_heading),
            Mistake(
                "the Jacobian by the pose has the wrong sign: the landmark comes nearer when the robot moves",
                _signs_turned,
            ),
        ),
    ),
    Exercise(
        "gate",
        ("squared distance",),
        _innovation,
        _gate,
        (
            Mistake(
                "the covariance of the prediction is missing: what is seen is not all that is uncertain",
                lambda v, H, P, R: v @ np.linalg.solve(R, v),
            ),
            Mistake("the noise of the observation is missing", lambda v, H, P, R: _gate(v, H, P, 0.0 * R)),
            Mistake("the covariance is not inverted", lambda v, H, P, R: v @ (H @ P @ H.T + R) @ v),
            Mistake(
                "this is its root: gates are of the squared distance", lambda v, H, P, R: math.sqrt(_gate(v, H, P, R))
            ),
        ),
    ),
    Exercise(
        "update",
        ("mean", "covariance"),
        _measured,
        _update,
        (
            Mistake(
                "the covariance stays as it was: an observation makes it smaller",
                lambda x, P, H, R, v: (_update(x, P, H, R, v)[0], P),
            ),
            Mistake("the innovation has the wrong sign", lambda x, P, H, R, v: _update(x, P, H, R, -v)),
            Mistake(
                "the gain leaves out the noise of the observation", lambda x, P, H, R, v: _update(x, P, H, 0.0 * R, v)
            ),
            Mistake(
                "the covariance grows: the gain has the wrong sign there",
                lambda x, P, H, R, v: (_update(x, P, H, R, v)[0], 2.0 * P - _update(x, P, H, R, v)[1]),
            ),
        ),
    ),
    Exercise(
        "augment",
        ("landmark", "covariance"),
        _first_seen,
        _augmented,
        (
            Mistake("the landmark is correlated with pose and map: it was seen from that pose", _uncorrelated),
            Mistake("the noise of the observation is in the robot's axes and is not turned", _noise_not_turned),
            Mistake("the noise of the observation is missing", lambda a, P, z, R: _augmented(a, P, z, 0.0 * R)),
            Mistake(
                "the landmark is turned the wrong way", lambda a, P, z, R: _augmented(Pose(a.x, a.y, -a.theta), P, z, R)
            ),
        ),
    ),
    Exercise(
        "carried",
        ("point", "covariance"),
        lambda rng: (pose(rng), cov(rng, 3), rng.uniform(-3.0, 3.0, 2), cov(rng, 2, 0.2)),
        _carried,
        (
            Mistake(
                "the point's covariance is not turned into the map's axes",
                lambda a, P, p, R: (_carried(a, P, p, R)[0], _carried(a, P, p, 0.0 * R)[1] + R),
            ),
            Mistake(
                "the pose is uncertain, too",
                lambda a, P, p, R: (_carried(a, P, p, R)[0], _carried(a, 0.0 * P, p, R)[1]),
            ),
            Mistake(
                "the heading's error moves the point, too",
                lambda a, P, p, R: (_carried(a, P, p, R)[0], P[:2, :2] + _carried(a, 0.0 * P, p, R)[1]),
            ),
            Mistake(
                "the point is turned the wrong way", lambda a, P, p, R: _carried(Pose(a.x, a.y, -a.theta), P, p, R)
            ),
        ),
    ),
    Judged("EKF-SLAM", _judge_estimator),
    Exercise(
        "turn of the world",
        ("direction",),
        lambda rng: (pose(rng), points(rng, 3)),
        _turn_of_world,
        (
            Mistake(
                "the world turns the other way, and the heading does not",
                lambda a, L: np.where(np.arange(3 + 2 * len(L)) == 2, 1.0, -_turn_of_world(a, L)),
            ),
            Mistake(
                "the landmarks turn with the world, too",
                lambda a, L: np.append(_turn_of_world(a, L)[:3], np.zeros(2 * len(L))),
            ),
            Mistake(
                "the robot moves, too: the world turns about its origin",
                lambda a, L: np.append([0.0, 0.0, 1.0], _turn_of_world(a, L)[3:]),
            ),
        ),
    ),
    Exercise(
        "first estimates",
        ("Jacobian",),
        lambda rng: (pose(rng), pose(rng)),
        lambda a, b: np.array([[1.0, 0.0, a.y - b.y], [0.0, 1.0, b.x - a.x], [0.0, 0.0, 1.0]]),
        (
            Mistake(
                "the last column has the wrong sign",
                lambda a, b: np.array([[1.0, 0.0, b.y - a.y], [0.0, 1.0, a.x - b.x], [0.0, 0.0, 1.0]]),
            ),
            Mistake(
                "the difference of the positions is already in the world's axes",
                lambda a, b: _motion_jacobian(a, Pose(b.x - a.x, b.y - a.y, 0.0)),
            ),
        ),
    ),
    Exercise(
        "iterate",
        ("mean",),
        _linearised,
        _iterate,
        (
            Mistake(
                "the prediction counts again at each iterate: start from it, not from the iterate",
                lambda x, at, P, H, R, v: at + (_update(x, P, H, R, v)[0] - x),
            ),
            Mistake(
                "the innovation was taken at the iterate: lead it back to the prediction",
                lambda x, at, P, H, R, v: _update(x, P, H, R, v)[0],
            ),
            Mistake("led back in the wrong direction", lambda x, at, P, H, R, v: _iterate(x, 2.0 * x - at, P, H, R, v)),
        ),
    ),
    Exercise(
        "forget",
        ("covariance",),
        lambda rng: (cov(rng, 9), int(rng.integers(0, 3))),
        _without,
        (
            Mistake("this is the covariance if the landmark were known exactly: forgetting adds no knowledge", _held),
            Mistake(
                "the pose has three numbers before the first landmark",
                lambda P, k: np.delete(np.delete(P, [2 * k, 2 * k + 1], 0), [2 * k, 2 * k + 1], 1),
            ),
        ),
    ),
    Exercise(
        "exp",
        ("x, y, theta",),
        lambda rng: (*rng.uniform(-2.0, 2.0, 2), rng.uniform(0.3, 2.5)),
        _exp,
        (
            Mistake("the turn bends the way: a twist is driven, not jumped", lambda v, u, w: np.array([v, u, w])),
            Mistake("it bends the other way", lambda v, u, w: _exp(v, u, -w) * np.array([1.0, 1.0, -1.0])),
            Mistake("all of the way has the last heading", lambda v, u, w: np.append(rotation(w) @ [v, u], w)),
        ),
    ),
    Exercise(
        "compound",
        ("covariance",),
        lambda rng: (cov(rng, 3), pose(rng), cov(rng, 3)),
        _compound,
        (
            Mistake(
                "the first error is in the axes of the middle: lead it back through the step, not on",
                lambda P, s, Q: s.adjoint() @ P @ s.adjoint().T + Q,
            ),
            Mistake("covariances in different axes are added", lambda P, s, Q: P + Q),
            Mistake(
                "the adjoint is transposed", lambda P, s, Q: s.inverse().adjoint().T @ P @ s.inverse().adjoint() + Q
            ),
        ),
    ),
    Exercise(
        "inside",
        ("squared distance",),
        _near,
        _squared,
        (
            Mistake(
                "the difference is of coordinates in the world: take it in the tangent at the mean", _by_coordinates
            ),
            Mistake("the logarithm is missing: the motion from the mean is not yet in the tangent", _by_relative),
        ),
    ),
    Exercise(
        "weights",
        ("weights",),
        lambda rng: (rng.uniform(-30.0, -2.0, 8) - 900.0,),
        _weights,
        (
            Mistake("all weights are zero: take off the largest logarithm before the exponential", _plain_weights),
            Mistake("the weights do not add up to one", lambda logs: np.exp(logs - logs.max())),
        ),
    ),
    Exercise(
        "resample",
        ("indices",),
        _particles,
        _resampled,
        (
            Mistake(
                "one comb with one offset: the teeth are one over N apart and begin at u over N",
                lambda w, u: _resampled(w, 0.0),
            ),
            Mistake(
                "all teeth lie at the same place", lambda w, u: np.repeat(np.searchsorted(np.cumsum(w), u), len(w))
            ),
            Mistake("each particle is kept once, whatever its weight", lambda w, u: np.arange(len(w))),
            Mistake(
                "the weights are not accumulated",
                lambda w, u: np.searchsorted(np.sort(w), (u + np.arange(len(w))) / len(w)),
            ),
        ),
    ),
    Exercise(
        "effective particles",
        ("number",),
        lambda rng: (_particles(rng)[0],),
        lambda w: 1.0 / np.sum(w**2),
        (
            Mistake("this is one over the largest weight", lambda w: 1.0 / w.max()),
            Mistake("upside down", lambda w: np.sum(w**2)),
            Mistake("a share, not a number: multiplied by N", lambda w: 1.0 / np.sum(w**2) / len(w)),
        ),
    ),
)
