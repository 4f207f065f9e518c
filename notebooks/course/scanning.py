"""Exercises on scans: features, alignment, occupancy."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from course.drawn import mask, points
from course.exercise import Exercise
from sixthsense.core.geometry import Array, rotation


def _scan(rng: np.random.Generator) -> tuple[Any, ...]:
    ranges, most = rng.uniform(0.5, 7.0, 12), 8.0
    ranges[rng.choice(12, 3, replace=False)] = most
    return ranges, np.linspace(-2.0, 1.7, 12), most


def _wall(rng: np.random.Generator) -> tuple[Array]:
    alpha, d = rng.uniform(-3.0, 3.0), rng.uniform(0.8, 4.0)
    along = np.sort(rng.uniform(-3.0, 1.0, 9))
    return (np.column_stack([d + 0.2 * rng.standard_normal(9), along]) @ rotation(alpha).T,)


def _regression(_: Any, places: Array) -> tuple[float, float]:
    slope, offset = np.polyfit(places[:, 0], places[:, 1], 1)
    sign = 1.0 if offset >= 0.0 else -1.0
    return math.atan2(sign, -sign * slope), abs(offset) / math.hypot(1.0, slope)


def _pairs(rng: np.random.Generator) -> tuple[Array, Array]:
    targets = points(rng, 7)
    moved = targets @ rotation(rng.uniform(-3.0, 3.0)).T + rng.uniform(-3.0, 3.0, 2)
    return moved + 0.1 * rng.standard_normal((7, 2)), targets


def _walls(rng: np.random.Generator) -> tuple[Array, Array, Array]:
    places, angles = points(rng, 8), rng.uniform(-3.0, 3.0, 8)
    return places, places + 0.1 * rng.standard_normal((8, 2)), np.column_stack([np.cos(angles), np.sin(angles)])


def _coarse_beam(_: Any, start: Array, end: Array) -> Array:
    steps = int(np.abs(np.floor(end) - np.floor(start)).max())
    return np.floor(start + np.linspace(0.0, 1.0, steps + 1)[:, None] * (end - start))


EXERCISES = {
    "returns": Exercise(
        ("points",),
        _scan,
        mistakes={
            "beams without a return count, too: their range is the largest": lambda right, d, b, _: right(
                d, b, math.inf
            )
        },
    ),
    "gap": Exercise(
        ("largest distance",),
        lambda rng: (rng.uniform(0.5, 9.0), rng.uniform(0.004, 0.03), rng.uniform(0.1, 0.4), rng.uniform(0.005, 0.03)),
        mistakes={
            "the angle between wall and next beam is smaller, not larger": lambda right, d, b, i, s: right(
                d, b, i + 2.0 * b, s
            ),
            "the noise counts once: three sigmas are asked for": lambda right, d, b, i, s: right(d, b, i, s / 3.0),
        },
    ),
    "line": Exercise(
        ("alpha", "d"),
        _wall,
        mistakes={
            "these are the squares in y: a wall may stand upright, use distances across it": _regression,
            "alpha is the direction of the wall, not of its normal": lambda right, p: (
                math.remainder(right(p)[0] + 0.5 * math.pi, 2.0 * math.pi),
                right(p)[1],
            ),
        },
    ),
    "rigid": Exercise(
        ("x, y, theta",),
        _pairs,
        mistakes={
            "the points' middle is not turned before it is moved": lambda right, p, q: np.append(
                q.mean(axis=0) - p.mean(axis=0), right(p, q)[2]
            )
        },
    ),
    "matches": Exercise(
        ("index of the nearest target", "whether it is near"),
        lambda rng: (points(rng, 9), points(rng, 14), 1.2),
        mistakes={
            "every point has a match: those beyond the reach have none": lambda right, a, b, _: right(a, b, math.inf),
            "squared distances are compared with the reach": lambda right, a, b, far: right(a, b, math.sqrt(far)),
        },
    ),
    "to lines": Exercise(
        ("x, y, theta",),
        _walls,
        mistakes={
            "the turn moves a point the other way": lambda right, *given: right(*given) * (1.0, 1.0, -1.0),
            "these are distances to the points: only what lies along the normals counts": lambda right, p, q, _: right(
                np.tile(p, (2, 1)), np.tile(q, (2, 1)), np.repeat(np.eye(2), len(p), axis=0)
            ),
        },
    ),
    "log odds": Exercise(
        ("log odds",),
        lambda rng: (rng.normal(), rng.uniform(0.1, 0.9), rng.uniform(0.3, 0.45)),
        mistakes={
            "the prior counts again with each look": lambda right, odds, p, _: right(odds, p, 0.5),
            "a probability is added to log odds": lambda _, odds, p, prior: odds + p - prior,
        },
    ),
    "beam": Exercise(
        ("cells",),
        lambda rng: (rng.uniform(-3.0, 2.0, 2), rng.uniform(4.0, 9.0, 2) * rng.choice([-1.0, 1.0], 2)),
        mistakes={
            "the last cell is missing": lambda right, a, b: right(a, b)[:-1],
            "as many cells as the longer side has: a beam that crosses a corner's side cuts two": _coarse_beam,
            "rounded: a cell begins at its lower corner": lambda right, a, b: right(a + 0.5, b + 0.5),
        },
    ),
    "probability": Exercise(
        ("probability",),
        lambda rng: (rng.normal(0.0, 2.0, 6),),
        mistakes={"these are the odds": lambda _, odds: np.exp(odds)},
    ),
    "score": Exercise(
        ("share of points",),
        lambda rng: (rng.uniform(-1.0, 6.0, (40, 2)), mask(rng, 0.4), np.array([-0.3, 0.7]), 0.45),
    ),
}
