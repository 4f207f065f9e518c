"""Exercises on errors and their statistics."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from scipy.stats import chi2, norm, t

from course.drawn import cov, pose
from course.exercise import Exercise, Mistake
from sixthsense.core.geometry import Array, Pose, rotation


def _covs(rng: np.random.Generator, count: int) -> Array:
    return np.array([cov(rng, 3) for _ in range(count)])


def _nees(errors: Array, covs: Array) -> Array:
    return np.asarray(np.einsum("ki,kij,kj->k", errors, np.linalg.inv(covs), errors))


def _relation(first: Pose, second: Pose, relation: Pose) -> tuple[float, float]:
    off = relation.inverse() @ (first.inverse() @ second)
    return math.hypot(off.x, off.y), abs(off.theta)


def _absolute_relation(first: Pose, second: Pose, relation: Pose) -> tuple[float, float]:
    moved = second.array() - first.array() - relation.array()
    return math.hypot(moved[0], moved[1]), abs(math.remainder(moved[2], 2.0 * math.pi))


def _nis(innovations: list[Array], covs: list[Array]) -> float:
    total = sum(v @ np.linalg.solve(S, v) for v, S in zip(innovations, covs, strict=True))
    return float(total / sum(map(len, innovations)))


def _innovations(rng: np.random.Generator) -> tuple[Any, ...]:
    sizes = (2, 6, 4, 8)
    return [rng.standard_normal(n) for n in sizes], [cov(rng, n, 0.5) for n in sizes]


def _paired(first: Array, second: Array) -> tuple[float, float]:
    off = second - first
    return off.mean(), t.ppf(0.975, len(off) - 1) * off.std(ddof=1) / math.sqrt(len(off))


def _fused(first: Array, first_cov: Array, second: Array, second_cov: Array) -> tuple[Array, Array]:
    gain = first_cov @ np.linalg.inv(first_cov + second_cov)
    return first + gain @ (second - first), first_cov - gain @ first_cov


def _spreads(rng: np.random.Generator) -> tuple[Array]:
    return (rng.standard_normal((7, 2)) @ np.array([[1.0, 0.4], [0.0, 0.6]]) + np.array([0.7, -0.4]),)


EXERCISES = (
    Exercise(
        "nees",
        ("NEES",),
        lambda rng: (rng.standard_normal((4, 3)), _covs(rng, 4)),
        _nees,
        (
            Mistake("the covariance is not inverted", lambda e, P: np.einsum("ki,kij,kj->k", e, P, e)),
            Mistake("this is its root: NEES is the squared distance", lambda e, P: np.sqrt(_nees(e, P))),
            Mistake(
                "the correlations are left out",
                lambda e, P: np.sum(e**2 / np.diagonal(P, axis1=1, axis2=2), axis=1),
            ),
        ),
    ),
    Exercise(
        "ate",
        ("ATE, m",),
        lambda rng: (rng.standard_normal((9, 3)), rng.standard_normal((9, 3))),
        lambda a, b: np.sqrt(np.mean(np.sum((a - b)[:, :2] ** 2, axis=1))),
        (
            Mistake(
                "this is the mean distance, not its root mean square", lambda a, b: np.hypot(*(a - b).T[:2]).mean()
            ),
            Mistake("the root is missing", lambda a, b: np.mean(np.sum((a - b)[:, :2] ** 2, axis=1))),
            Mistake("the heading counts, too, in radians", lambda a, b: np.sqrt(np.mean(np.sum((a - b) ** 2, axis=1)))),
            Mistake(
                "the mean is over both axes, this is the error per axis",
                lambda a, b: np.sqrt(np.mean((a - b)[:, :2] ** 2)),
            ),
        ),
    ),
    Exercise(
        "spread",
        ("covariance",),
        _spreads,
        lambda errors: errors.T @ errors / len(errors),
        (
            Mistake("the mean is taken off: noise of mean zero is measured about zero", lambda e: np.cov(e.T)),
            Mistake("the mean is taken off: noise of mean zero is measured about zero", lambda e: np.cov(e.T, ddof=0)),
            Mistake("divided by one too few: no mean was estimated", lambda e: e.T @ e / (len(e) - 1)),
            Mistake("the sum is not divided by the number of errors", lambda e: e.T @ e),
        ),
    ),
    Exercise(
        "relation",
        ("error, m", "error, rad"),
        lambda rng: (pose(rng), pose(rng), pose(rng)),
        _relation,
        (
            Mistake(
                "the motion is a difference in the world's axes: it is seen from the first pose", _absolute_relation
            ),
            Mistake(
                "the motion goes from the second pose to the first",
                lambda a, b, r: _relation(b, a, r),
            ),
            Mistake("the relation is not inverted: the errors add up", lambda a, b, r: _relation(a, b, r.inverse())),
        ),
    ),
    Exercise(
        "nis",
        ("NIS per degree of freedom",),
        _innovations,
        _nis,
        (
            Mistake(
                "every step counts the same: one with more numbers has more degrees of freedom",
                lambda vs, Ss: np.mean([v @ np.linalg.solve(S, v) / len(v) for v, S in zip(vs, Ss, strict=True)]),
            ),
            Mistake(
                "divided by the number of steps, not by the degrees of freedom",
                lambda vs, Ss: np.mean([v @ np.linalg.solve(S, v) for v, S in zip(vs, Ss, strict=True)]),
            ),
            Mistake(
                "the covariance is not inverted",
                lambda vs, Ss: sum(v @ S @ v for v, S in zip(vs, Ss, strict=True)) / sum(map(len, vs)),
            ),
        ),
    ),
    Exercise(
        "band",
        ("band",),
        lambda rng: (int(rng.integers(3, 60)), int(rng.integers(1, 7))),
        lambda runs, dof: chi2.ppf([0.025, 0.975], runs * dof) / runs,
        (
            Mistake("this is the band of the sum, not of the mean", lambda n, d: chi2.ppf([0.025, 0.975], n * d)),
            Mistake(
                "this is the band of one run: the mean of many scatters less", lambda n, d: chi2.ppf([0.025, 0.975], d)
            ),
            Mistake("five per cent lie outside on each side", lambda n, d: chi2.ppf([0.05, 0.95], n * d) / n),
            Mistake(
                "divided by the degrees of freedom, too: the mean is of the NEES",
                lambda n, d: chi2.ppf([0.025, 0.975], n * d) / (n * d),
            ),
        ),
    ),
    Exercise(
        "paired",
        ("mean", "half of the interval"),
        lambda rng: (rng.uniform(2.0, 9.0, 6), rng.uniform(2.0, 9.0, 6)),
        _paired,
        (
            Mistake("first minus second: the difference is second minus first", lambda a, b: _paired(b, a)),
            Mistake(
                "the spreads of both are added: of pairs it is the spread of the differences",
                lambda a, b: (
                    (b - a).mean(),
                    t.ppf(0.975, len(a) - 1) * math.sqrt((a.var(ddof=1) + b.var(ddof=1)) / len(a)),
                ),
            ),
            Mistake(
                "the quantile is the normal one: six differences do not tell their sigma well",
                lambda a, b: ((b - a).mean(), norm.ppf(0.975) * (b - a).std(ddof=1) / math.sqrt(len(a))),
            ),
            Mistake(
                "the spread is divided by n: the mean has been estimated from the same numbers",
                lambda a, b: ((b - a).mean(), t.ppf(0.975, len(a) - 1) * (b - a).std() / math.sqrt(len(a))),
            ),
            Mistake(
                "this is the spread of one difference, not of their mean",
                lambda a, b: ((b - a).mean(), t.ppf(0.975, len(a) - 1) * (b - a).std(ddof=1)),
            ),
        ),
    ),
    Exercise(
        "fuse",
        ("mean", "covariance"),
        lambda rng: (rng.standard_normal(2), cov(rng, 2), rng.standard_normal(2), cov(rng, 2)),
        _fused,
        (
            Mistake(
                "the weights are exchanged: the more certain one counts more",
                lambda a, A, b, B: (_fused(a, B, b, A)[0], _fused(a, A, b, B)[1]),
            ),
            Mistake("both count the same", lambda a, A, b, B: (0.5 * (a + b), _fused(a, A, b, B)[1])),
            Mistake(
                "the covariances are added, and two estimates are worth more than one",
                lambda a, A, b, B: (_fused(a, A, b, B)[0], A + B),
            ),
            Mistake("the covariance is that of the plain mean", lambda a, A, b, B: (0.5 * (a + b), 0.25 * (A + B))),
        ),
    ),
    Exercise(
        "effective number",
        ("effective number",),
        lambda rng: (int(rng.integers(200, 5000)), rng.uniform(0.2, 0.98)),
        lambda count, rho: count * (1.0 - rho) / (1.0 + rho),
        (
            Mistake("the samples count as independent", lambda n, rho: n + 0.0 * rho),
            Mistake("upside down: correlated samples are worth less", lambda n, rho: n * (1.0 + rho) / (1.0 - rho)),
            Mistake(
                "only one neighbour counts: the correlation goes on, to both sides", lambda n, rho: n * (1.0 - rho)
            ),
        ),
    ),
    Exercise(
        "body axes",
        ("covariance",),
        lambda rng: (cov(rng, 3), rng.uniform(-3.0, 3.0)),
        lambda P, theta: _turned(P, theta),
        (
            Mistake("turned the other way", lambda P, theta: _turned(P, -theta)),
            Mistake(
                "the correlations of position and heading are not turned",
                lambda P, theta: np.block([[_turned(P, theta)[:2, :2], P[:2, 2:]], [P[2:, :2], P[2:, 2:]]]),
            ),
        ),
    ),
)


def _turned(P: Array, theta: float) -> Array:
    C = np.eye(3)
    C[:2, :2] = rotation(theta)
    return np.asarray(C.T @ P @ C)
