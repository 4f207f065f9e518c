"""Exercises on errors and their statistics."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from scipy.stats import chi2, norm, t

from course.drawn import cov, pose
from course.exercise import Exercise, Mistakes
from sixthsense.core.geometry import Array, Pose
from sixthsense.core.se2 import move_covariance
from sixthsense.evaluation.metrics import ate, nees_band, relations_error, squares


def _relation(first: Pose, second: Pose, relation: Pose) -> tuple[Array, Array]:
    poses = np.array([first.array(), second.array()])
    metres, radians = relations_error(np.arange(2.0), poses, np.array([[0.0, 1.0]]), relation.array()[None])
    return metres[0], radians[0]


def _by_coordinates(first: Pose, second: Pose, relation: Pose) -> tuple[float, float]:
    moved = second.array() - first.array() - relation.array()
    return math.hypot(moved[0], moved[1]), abs(math.remainder(moved[2], 2.0 * math.pi))


def _nis(innovations: list[Array], covs: list[Array]) -> float:
    total = sum(squares(v[None], S[None])[0] for v, S in zip(innovations, covs, strict=True))
    return float(total / sum(map(len, innovations)))


def _innovations(rng: np.random.Generator) -> tuple[Any, ...]:
    sizes = (2, 6, 4, 8)
    return [rng.standard_normal(n) for n in sizes], [cov(rng, n, 0.5) for n in sizes]


def _paired(first: Array, second: Array) -> tuple[float, float]:
    off = second - first
    return off.mean(), t.ppf(0.975, len(off) - 1) * off.std(ddof=1) / math.sqrt(len(off))


def _spreads_added(first: Array, second: Array) -> tuple[float, float]:
    sigma = math.sqrt((first.var(ddof=1) + second.var(ddof=1)) / len(first))
    return (second - first).mean(), t.ppf(0.975, len(first) - 1) * sigma


def _fused(first: Array, first_cov: Array, second: Array, second_cov: Array) -> tuple[Array, Array]:
    informations = np.linalg.inv(first_cov), np.linalg.inv(second_cov)
    both = np.asarray(np.linalg.inv(informations[0] + informations[1]))
    return both @ (informations[0] @ first + informations[1] @ second), both


def _spreads(rng: np.random.Generator) -> tuple[Array]:
    return (rng.standard_normal((7, 2)) @ np.array([[1.0, 0.4], [0.0, 0.6]]) + np.array([0.7, -0.4]),)


def _turned(P: Array, theta: float) -> Array:
    return move_covariance((0.0, 0.0, -theta), P)


def _block_turned(P: Array, theta: float) -> Array:
    return np.block([[_turned(P, theta)[:2, :2], P[:2, 2:]], [P[2:, :2], P[2:, 2:]]])


EXERCISES = {
    "nees": Exercise(
        ("NEES",), lambda rng: (rng.standard_normal((4, 3)), np.array([cov(rng, 3) for _ in range(4)])), squares
    ),
    "ate": Exercise(("ATE, m",), lambda rng: (rng.standard_normal((9, 3)), rng.standard_normal((9, 3))), ate),
    "spread": Exercise(("covariance",), _spreads, lambda errors: errors.T @ errors / len(errors)),
    "relation": Exercise(("error, m", "error, rad"), lambda rng: (pose(rng), pose(rng), pose(rng)), _relation),
    "nis": Exercise(("NIS per degree of freedom",), _innovations, _nis),
    "band": Exercise(
        ("band",),
        lambda rng: (int(rng.integers(3, 60)), int(rng.integers(2, 7))),
        lambda runs, dof: np.array(nees_band(runs, dof)),
    ),
    "paired": Exercise(
        ("mean", "half of the interval"), lambda rng: (rng.uniform(2.0, 9.0, 6), rng.uniform(2.0, 9.0, 6)), _paired
    ),
    "fuse": Exercise(
        ("mean", "covariance"),
        lambda rng: (rng.standard_normal(2), cov(rng, 2), rng.standard_normal(2), cov(rng, 2)),
        _fused,
    ),
    "effective number": Exercise(
        ("effective number",),
        lambda rng: (int(rng.integers(200, 5000)), rng.uniform(0.2, 0.98)),
        lambda count, rho: count * (1.0 - rho) / (1.0 + rho),
    ),
    "body axes": Exercise(("covariance",), lambda rng: (cov(rng, 3), rng.uniform(-3.0, 3.0)), _turned),
}

MISTAKES: Mistakes = {
    "ate": {
        "this is the mean distance, not its root mean square": lambda a, b: np.hypot(*(a - b).T[:2]).mean(),
        "the heading counts, too, in radians": lambda a, b: np.sqrt(np.mean(np.sum((a - b) ** 2, axis=1))),
    },
    "spread": {
        "the mean is taken off: noise of mean zero is measured about zero": lambda e: np.cov(e.T),
        "the mean is taken off, although noise has the mean zero": lambda e: np.cov(e.T, ddof=0),
    },
    "relation": {"the motion is a difference in the world's axes: it is seen from the first pose": _by_coordinates},
    "nis": {
        "every step counts the same: one with more numbers has more degrees of freedom": lambda vs, Ss: np.mean(
            [_nis([v], [S]) for v, S in zip(vs, Ss, strict=True)]
        )
    },
    "band": {
        "the band is of one run: the mean of many scatters less": lambda n, d: chi2.ppf([0.025, 0.975], d),
        "five per cent lie outside on each side": lambda n, d: chi2.ppf([0.05, 0.95], n * d) / n,
    },
    "paired": {
        "the spreads of both are added: of pairs it is the spread of the differences": _spreads_added,
        "the quantile is the normal one, six differences do not tell their sigma well": lambda a, b: (
            (b - a).mean(),
            norm.ppf(0.975) * (b - a).std(ddof=1) / math.sqrt(len(a)),
        ),
    },
    "fuse": {
        "both count the same": lambda a, A, b, B: (0.5 * (a + b), _fused(a, A, b, B)[1]),
        "the covariances are added: two estimates are better than one": lambda a, A, b, B: (
            _fused(a, A, b, B)[0],
            A + B,
        ),
        "the covariance is of the plain mean": lambda a, A, b, B: (0.5 * (a + b), 0.25 * (A + B)),
    },
    "effective number": {
        "only one neighbour counts: the correlation goes on, to both sides": lambda n, rho: n * (1.0 - rho)
    },
    "body axes": {"the correlations of position and heading are not turned": _block_turned},
}
