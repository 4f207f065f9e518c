"""Exercises on loops and pose graphs."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from course.drawn import cov, pose
from course.exercise import Exercise, Mistakes
from sixthsense.core.geometry import Array, Pose, rotation, wrap_angle
from sixthsense.core.se2 import between, compose

Pairs = NDArray[np.int64]


def _residual(first: Pose, second: Pose, measured: Pose) -> Array:
    return between(measured.array(), between(first.array(), second.array()))


def _jacobians(first: Pose, second: Pose, measured: Pose) -> tuple[Array, Array]:
    to_measured, (x, y) = rotation(first.theta + measured.theta).T, second.position - first.position
    by_first, by_second = np.zeros((3, 3)), np.eye(3)
    by_first[:2, :2], by_second[:2, :2] = -to_measured, to_measured
    by_first[:2, 2], by_first[2, 2] = to_measured @ [y, -x], -1.0
    return by_first, by_second


def _heading_holds(first: Pose, second: Pose, measured: Pose) -> tuple[Array, Array]:
    by_first, by_second = _jacobians(first, second, measured)
    by_first[:2, 2] = 0.0
    return by_first, by_second


def _edge(rng: np.random.Generator) -> tuple[Pose, Pose, Pose]:
    return pose(rng), pose(rng), pose(rng)


def _plain_difference(first: Pose, second: Pose, measured: Pose) -> Array:
    off = between(first.array(), second.array()) - measured.array()
    off[2] = wrap_angle(off[2])
    return np.asarray(off)


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
    truth = [pose(rng).array()]
    for _ in range(5):
        step = np.array([rng.uniform(0.8, 1.4), rng.uniform(-0.2, 0.2), rng.uniform(0.8, 1.1)])
        truth.append(compose(truth[-1], step))
    pairs = np.array([(0, 1), (1, 2), (2, 3), (3, 4), (4, 5), (5, 0), (1, 4)])
    measured = np.array([between(truth[i], truth[j]) for i, j in pairs]) + rng.normal(0.0, 0.05, (len(pairs), 3))
    measured[:, 2] = wrap_angle(measured[:, 2])
    start = [truth[0]]
    for step in measured[:5]:
        start.append(compose(start[-1], step))
    information = np.array([np.linalg.inv(cov(rng, 3, 0.05) + 1e-4 * np.eye(3)) for _ in pairs])
    return np.array(start), pairs, measured, information


def _all_alike(start: Array, pairs: Pairs, measured: Array, information: Array) -> Array:
    return _optimised(start, pairs, measured, np.broadcast_to(np.eye(3), information.shape))


EXERCISES = {
    "bent": Exercise(
        ("sigma",),
        lambda rng: (rng.uniform(0.003, 0.02), rng.uniform(40.0, 200.0), rng.uniform(4.0, 36.0)),
        lambda slip, length, at: slip * math.sqrt(at * (length - at) / length),
    ),
    "residual": Exercise(("x, y, theta",), _edge, _residual),
    "edge jacobians": Exercise(("by the first pose", "by the second pose"), _edge, _jacobians),
    "pose graph": Exercise(("poses",), _graph, _optimised),
    "robust weight": Exercise(
        ("weights",),
        lambda rng: (rng.uniform(0.2, 6.0, 8), rng.uniform(1.0, 2.0)),
        lambda distances, most: np.minimum(1.0, most / distances),
    ),
}

MISTAKES: Mistakes = {
    "bent": {
        "the loop is not closed: the link to the start holds the other end": lambda s, _, at: s * math.sqrt(at),
        "the sigma goes with the root of the way": lambda s, length, at: s * at * (length - at) / length,
    },
    "residual": {
        "the difference is in the first pose's axes: see it from where the measurement ends": _plain_difference
    },
    "edge jacobians": {"the first pose's heading turns what is seen from it": _heading_holds},
    "pose graph": {
        "all edges count alike: weigh each by its information": _all_alike,
        "one step only: the residuals are not linear, go on until the step is small": lambda *graph: _optimised(
            *graph, 1
        ),
        "the poses are those of the start": lambda x, *_: x.copy(),
    },
    "robust weight": {
        "small residuals count in full, not more": lambda d, k: k / d,
        "large residuals count for nothing: this cuts them off": lambda d, k: np.where(d <= k, 1.0, 0.0),
    },
}
