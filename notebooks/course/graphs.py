"""Exercises on loops and pose graphs."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from course.drawn import cov, pose
from course.exercise import Exercise, Mistake
from sixthsense.core.geometry import Array, Pose, rotation, wrap_angle

Pairs = NDArray[np.int64]


def _residual(first: Pose, second: Pose, measured: Pose) -> Array:
    return (measured.inverse() @ (first.inverse() @ second)).array()


def _jacobians(first: Pose, second: Pose, measured: Pose) -> tuple[Array, Array]:
    to_measured, (x, y) = rotation(first.theta + measured.theta).T, second.position - first.position
    by_first, by_second = np.zeros((3, 3)), np.eye(3)
    by_first[:2, :2], by_second[:2, :2] = -to_measured, to_measured
    by_first[:2, 2], by_first[2, 2] = to_measured @ [y, -x], -1.0
    return by_first, by_second


def _edge(rng: np.random.Generator) -> tuple[Pose, Pose, Pose]:
    return pose(rng), pose(rng), pose(rng)


def _plain_difference(first: Pose, second: Pose, measured: Pose) -> Array:
    off = (first.inverse() @ second).array() - measured.array()
    off[2] = wrap_angle(off[2])
    return np.asarray(off)


def _world_difference(first: Pose, second: Pose, measured: Pose) -> Array:
    off = second.array() - first.array() - measured.array()
    off[2] = wrap_angle(off[2])
    return np.asarray(off)


def _unwrapped(first: Pose, second: Pose, measured: Pose) -> Array:
    return np.append(_residual(first, second, measured)[:2], second.theta - first.theta - measured.theta)


def _optimised(start: Array, pairs: Pairs, measured: Array, information: Array, rounds: int = 20) -> Array:
    poses = start.copy()
    for _ in range(rounds):
        H, g = np.zeros((3 * len(poses), 3 * len(poses))), np.zeros(3 * len(poses))
        for (i, j), z, W in zip(pairs, measured, information, strict=True):
            edge = Pose(*poses[i]), Pose(*poses[j]), Pose(*z)
            J = np.zeros((3, len(g)))
            J[:, 3 * i : 3 * i + 3], J[:, 3 * j : 3 * j + 3] = _jacobians(*edge)
            H, g = H + J.T @ W @ J, g + J.T @ W @ _residual(*edge)
        poses[1:] -= np.linalg.solve(H[3:, 3:], g[3:]).reshape(-1, 3)
        poses[:, 2] = wrap_angle(poses[:, 2])
    return poses


def _graph(rng: np.random.Generator) -> tuple[Any, ...]:
    """A drive around a loop, with a loop closure and a link across."""
    truth = [pose(rng)]
    for _ in range(5):
        truth.append(truth[-1] @ Pose(rng.uniform(0.8, 1.4), rng.uniform(-0.2, 0.2), rng.uniform(0.8, 1.1)))
    pairs = np.array([(0, 1), (1, 2), (2, 3), (3, 4), (4, 5), (5, 0), (1, 4)])
    noise = rng.normal(0.0, 0.05, (len(pairs), 3))
    measured = np.array([(truth[i].inverse() @ truth[j]).array() for i, j in pairs]) + noise
    measured[:, 2] = wrap_angle(measured[:, 2])
    start = [truth[0]]
    for step in measured[:5]:
        start.append(start[-1] @ Pose(*step))
    information = np.array([np.linalg.inv(cov(rng, 3, 0.05) + 1e-4 * np.eye(3)) for _ in pairs])
    return np.array([one.array() for one in start]), pairs, measured, information


def _all_alike(start: Array, pairs: Pairs, measured: Array, information: Array) -> Array:
    return _optimised(start, pairs, measured, np.broadcast_to(np.eye(3), information.shape))


def _huber(distances: Array, most: float) -> Array:
    return np.asarray(np.minimum(1.0, most / distances))


EXERCISES = (
    Exercise(
        "bent",
        ("sigma",),
        lambda rng: (rng.uniform(0.003, 0.02), rng.uniform(40.0, 200.0), rng.uniform(4.0, 36.0)),
        lambda slip, length, at: slip * math.sqrt(at * (length - at) / length),
        (
            Mistake(
                "the loop is not closed: the link to the start holds the other end",
                lambda s, length, at: s * math.sqrt(at),
            ),
            Mistake("this is the variance", lambda s, length, at: s**2 * at * (length - at) / length),
            Mistake("the sigma goes with the root of the way", lambda s, length, at: s * at * (length - at) / length),
        ),
    ),
    Exercise(
        "residual",
        ("x, y, theta",),
        _edge,
        _residual,
        (
            Mistake(
                "the difference is in the first pose's axes: see it from where the measurement ends", _plain_difference
            ),
            Mistake("the motion is in the world's axes: see it from the first pose", _world_difference),
            Mistake("the angle is not wrapped: two headings differ by a half turn at most", _unwrapped),
            Mistake(
                "this is measured from the prediction: exchange the two",
                lambda a, b, z: ((a.inverse() @ b).inverse() @ z).array(),
            ),
        ),
    ),
    Exercise(
        "edge jacobians",
        ("by the first pose", "by the second pose"),
        _edge,
        _jacobians,
        (
            Mistake("the two are exchanged", lambda a, b, z: _jacobians(a, b, z)[::-1]),
            Mistake(
                "the first pose's heading turns what is seen from it",
                lambda a, b, z: (
                    _jacobians(a, b, z)[0] * np.array([[1.0, 1.0, 0.0], [1.0, 1.0, 0.0], [1.0, 1.0, 1.0]]),
                    _jacobians(a, b, z)[1],
                ),
            ),
            Mistake(
                "the measured turn is left out: the residual is seen from where the measurement ends",
                lambda a, b, z: _jacobians(a, b, Pose(z.x, z.y, 0.0)),
            ),
            Mistake(
                "both have the same sign: if both poses move alike, the residual stays",
                lambda a, b, z: (-_jacobians(a, b, z)[0], _jacobians(a, b, z)[1]),
            ),
        ),
    ),
    Exercise(
        "pose graph",
        ("poses",),
        _graph,
        _optimised,
        (
            Mistake("all edges count alike: weigh each by its information", _all_alike),
            Mistake(
                "one step only: the residuals are not linear, go on until the step is small",
                lambda x, p, z, W: _optimised(x, p, z, W, 1),
            ),
            Mistake("the poses are those of the start", lambda x, p, z, W: x.copy()),
            Mistake(
                "the information is not inverted, it is the weight itself",
                lambda x, p, z, W: _optimised(x, p, z, np.linalg.inv(W)),
            ),
        ),
    ),
    Exercise(
        "robust weight",
        ("weights",),
        lambda rng: (rng.uniform(0.2, 6.0, 8), rng.uniform(1.0, 2.0)),
        _huber,
        (
            Mistake("small residuals count in full, not more", lambda d, k: k / d),
            Mistake("large residuals count for nothing: this cuts them off", lambda d, k: np.where(d <= k, 1.0, 0.0)),
            Mistake(
                "the weight falls with the distance, not with its square", lambda d, k: np.minimum(1.0, (k / d) ** 2)
            ),
            Mistake(
                "the weight falls with the distance, not with its root", lambda d, k: np.minimum(1.0, np.sqrt(k / d))
            ),
        ),
    ),
)
