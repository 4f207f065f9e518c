"""Exercises on loops and pose graphs."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from course.drawn import cov, pose
from course.exercise import Exercise
from sixthsense.core.geometry import Array, Pose, wrap_angle
from sixthsense.core.se2 import between, compose


def _residual(first: Pose, second: Pose, measured: Pose) -> Array:
    return between(measured.array(), between(first.array(), second.array()))


def _edge(rng: np.random.Generator) -> tuple[Pose, Pose, Pose]:
    return pose(rng), pose(rng), pose(rng)


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


EXERCISES = {
    "bent": Exercise(
        ("sigma",),
        lambda rng: (rng.uniform(0.003, 0.02), rng.uniform(40.0, 200.0), rng.uniform(4.0, 36.0)),
        mistakes={
            "the loop is not closed: the link to the start holds the other end": lambda _, s, length, at: (
                s * math.sqrt(at)
            )
        },
    ),
    "residual": Exercise(("x, y, theta",), _edge, _residual),
    "edge jacobians": Exercise(
        ("by the first pose", "by the second pose"),
        _edge,
    ),
    "pose graph": Exercise(
        ("poses",),
        _graph,
        mistakes={
            "all edges count alike: weigh each by its information": lambda right, x, pairs, z, W: right(
                x, pairs, z, np.broadcast_to(np.eye(3), W.shape)
            )
        },
    ),
    "robust weight": Exercise(
        ("weights",),
        lambda rng: (rng.uniform(0.2, 6.0, 8), rng.uniform(1.0, 2.0)),
        mistakes={
            "small residuals count in full, not more": lambda _, d, k: k / d,
            "large residuals count for nothing: this cuts them off": lambda _, d, k: np.where(d <= k, 1.0, 0.0),
        },
    ),
}
