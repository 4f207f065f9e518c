"""Exercises on errors and their statistics."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.stats import chi2

from course.drawn import cov, pose
from course.exercise import Exercise
from sixthsense.core.geometry import Array, Pose
from sixthsense.core.se2 import move_covariance
from sixthsense.evaluation.metrics import ate, nees_band, relations_error, squares


def _relation(first: Pose, second: Pose, relation: Pose) -> tuple[Array, Array]:
    poses = np.array([first.array(), second.array()])
    metres, radians = relations_error(np.arange(2.0), poses, np.array([[0.0, 1.0]]), relation.array()[None])
    return metres[0], radians[0]


def _innovations(rng: np.random.Generator) -> tuple[Any, ...]:
    sizes = (2, 6, 4, 8)
    return [rng.standard_normal(n) for n in sizes], [cov(rng, n, 0.5) for n in sizes]


def _spreads(rng: np.random.Generator) -> tuple[Array]:
    return (rng.standard_normal((7, 2)) @ np.array([[1.0, 0.4], [0.0, 0.6]]) + np.array([0.7, -0.4]),)


EXERCISES = {
    "nees": Exercise(
        ("NEES",), lambda rng: (rng.standard_normal((4, 3)), np.array([cov(rng, 3) for _ in range(4)])), squares
    ),
    "ate": Exercise(
        ("ATE, m",),
        lambda rng: (rng.standard_normal((9, 3)), rng.standard_normal((9, 3))),
        ate,
        {
            "this is the mean distance, not its root mean square": lambda _, a, b: np.hypot(*(a - b).T[:2]).mean(),
            "the heading counts, too, in radians": lambda _, a, b: np.sqrt(np.mean(np.sum((a - b) ** 2, axis=1))),
        },
    ),
    "spread": Exercise(
        ("covariance",),
        _spreads,
        mistakes={"the mean is taken off: noise of mean zero is measured about zero": lambda _, e: np.cov(e.T)},
    ),
    "relation": Exercise(
        ("error, m", "error, rad"),
        lambda rng: (pose(rng), pose(rng), pose(rng)),
        _relation,
        {
            "the motion is a difference in the world's axes: it is seen from the first pose": lambda right, a, b, m: (
                right(Pose(), Pose(*(b.array() - a.array() - m.array())), Pose())
            )
        },
    ),
    "nis": Exercise(
        ("NIS per degree of freedom",),
        _innovations,
        mistakes={
            "every step counts the same: one with more numbers has more degrees of freedom": lambda right, vs, Ss: (
                np.mean([right([v], [S]) for v, S in zip(vs, Ss, strict=True)])
            )
        },
    ),
    "band": Exercise(
        ("band",),
        lambda rng: (int(rng.integers(3, 60)), int(rng.integers(2, 7))),
        lambda runs, dof: np.array(nees_band(runs, dof)),
        {
            "the band is of one run: the mean of many scatters less": lambda right, n, d: right(1, d),
            "five per cent lie outside on each side": lambda _, n, d: chi2.ppf([0.05, 0.95], n * d) / n,
        },
    ),
    "paired": Exercise(
        ("mean", "half of the interval"),
        lambda rng: (rng.uniform(2.0, 9.0, 6), rng.uniform(2.0, 9.0, 6)),
    ),
    "fuse": Exercise(
        ("mean", "covariance"),
        lambda rng: (rng.standard_normal(2), cov(rng, 2), rng.standard_normal(2), cov(rng, 2)),
        mistakes={
            "both count the same": lambda right, a, A, b, B: (0.5 * (a + b), right(a, A, b, B)[1]),
            "the covariances are added: two estimates are better than one": lambda right, a, A, b, B: (
                right(a, A, b, B)[0],
                A + B,
            ),
        },
    ),
    "effective number": Exercise(
        ("effective number",),
        lambda rng: (int(rng.integers(200, 5000)), rng.uniform(0.2, 0.98)),
        mistakes={
            "only one neighbour counts: the correlation goes on, to both sides": lambda _, n, rho: n * (1.0 - rho)
        },
    ),
    "body axes": Exercise(
        ("covariance",),
        lambda rng: (cov(rng, 3), rng.uniform(-3.0, 3.0)),
        lambda P, theta: move_covariance((0.0, 0.0, -theta), P),
        {
            "the correlations of position and heading are not turned": lambda right, P, theta: np.block(
                [[right(P, theta)[:2, :2], P[:2, 2:]], [P[2:]]]
            )
        },
    ),
}
