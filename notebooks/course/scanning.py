"""Exercises on scans: features, alignment, occupancy."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from course.drawn import mask, points
from course.exercise import Exercise, Mistakes
from sixthsense.core.geometry import Array, rotation


def _scan(rng: np.random.Generator) -> tuple[Any, ...]:
    ranges, most = rng.uniform(0.5, 7.0, 12), 8.0
    ranges[rng.choice(12, 3, replace=False)] = most
    return ranges, np.linspace(-2.0, 1.7, 12), most


def _polar(ranges: Array, bearings: Array) -> Array:
    return np.column_stack([ranges * np.cos(bearings), ranges * np.sin(bearings)])


def _wall(rng: np.random.Generator) -> tuple[Array]:
    alpha, d = rng.uniform(-3.0, 3.0), rng.uniform(0.8, 4.0)
    along = np.sort(rng.uniform(-3.0, 1.0, 9))
    return (np.column_stack([d + 0.2 * rng.standard_normal(9), along]) @ rotation(alpha).T,)


def _line(places: Array) -> tuple[float, float]:
    middle = places.mean(axis=0)
    n = np.linalg.eigh(np.cov(places.T))[1][:, 0]
    n = n if n @ middle >= 0.0 else -n
    return math.atan2(n[1], n[0]), float(n @ middle)


def _regression(places: Array) -> tuple[float, float]:
    slope, offset = np.polyfit(places[:, 0], places[:, 1], 1)
    sign = 1.0 if offset >= 0.0 else -1.0
    return math.atan2(sign, -sign * slope), abs(offset) / math.hypot(1.0, slope)


def _turned_line(places: Array, turn: float, sign: float) -> tuple[float, float]:
    alpha, d = _line(places)
    return math.remainder(alpha + turn, 2.0 * math.pi), sign * d


def _pairs(rng: np.random.Generator) -> tuple[Array, Array]:
    targets = points(rng, 7)
    moved = targets @ rotation(rng.uniform(-3.0, 3.0)).T + rng.uniform(-3.0, 3.0, 2)
    return moved + 0.1 * rng.standard_normal((7, 2)), targets


def _best_turn(a: Array, b: Array) -> float:
    return math.atan2(float(np.sum(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])), float(np.sum(a * b)))


def _rigid(places: Array, targets: Array) -> Array:
    theta = _best_turn(places - places.mean(axis=0), targets - targets.mean(axis=0))
    return np.array([*(targets.mean(axis=0) - rotation(theta) @ places.mean(axis=0)), theta])


def _plain_shift(places: Array, targets: Array) -> Array:
    return np.array([*(targets.mean(axis=0) - places.mean(axis=0)), _rigid(places, targets)[2]])


def _not_centred(a: Array, b: Array) -> Array:
    theta = _best_turn(a, b)
    return np.array([*(b.mean(axis=0) - rotation(theta) @ a.mean(axis=0)), theta])


def _walls(rng: np.random.Generator) -> tuple[Array, Array, Array]:
    places, angles = points(rng, 8), rng.uniform(-3.0, 3.0, 8)
    return places, places + 0.1 * rng.standard_normal((8, 2)), np.column_stack([np.cos(angles), np.sin(angles)])


def _to_lines(places: Array, targets: Array, normals: Array, lever: float = 1.0) -> Array:
    turned = lever * np.column_stack([-places[:, 1], places[:, 0]])
    A = np.column_stack([normals, np.sum(normals * turned, axis=1)])
    return np.asarray(np.linalg.lstsq(A, np.sum(normals * (targets - places), axis=1))[0])


def _to_points(places: Array, targets: Array, normals: Array) -> Array:
    both = [np.tile(axis, (len(places), 1)) for axis in np.eye(2)]
    return _to_lines(np.tile(places, (2, 1)), np.tile(targets, (2, 1)), np.concatenate(both))


def _matches(places: Array, targets: Array, reach_m: float) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    away, index = cKDTree(targets).query(places)
    return index, away < reach_m


def _odds(value: float) -> float:
    return math.log(value / (1.0 - value))


def _beam(start: Array, end: Array) -> NDArray[np.int64]:
    """Cells by the places where the beam crosses their borders."""
    moved = end - start
    cuts = [0.0, 1.0]
    for a, d in zip(start, moved, strict=True):
        low, high = sorted((a, a + d))
        cuts += [(line - a) / d for line in range(math.ceil(low), math.floor(high) + 1)]
    shares = np.sort(cuts)
    return np.asarray(np.floor(start + 0.5 * (shares[1:] + shares[:-1])[:, None] * moved), dtype=np.int64)


def _coarse_beam(start: Array, end: Array) -> NDArray[np.int64]:
    steps = int(np.abs(np.floor(end) - np.floor(start)).max())
    return np.floor(start + np.linspace(0.0, 1.0, steps + 1)[:, None] * (end - start)).astype(np.int64)


def _cell_score(places: Array, occupied: Array, origin: Array, cell_m: float) -> float:
    cols, rows = np.floor((places - origin) / cell_m).astype(int).T
    inside = (rows >= 0) & (cols >= 0) & (rows < occupied.shape[0]) & (cols < occupied.shape[1])
    return float(occupied[rows[inside], cols[inside]].sum() / len(places))


EXERCISES = {
    "returns": Exercise(("points",), _scan, lambda ranges, bearings, most: _polar(ranges, bearings)[ranges < most]),
    "gap": Exercise(
        ("largest distance",),
        lambda rng: (rng.uniform(0.5, 9.0), rng.uniform(0.004, 0.03), rng.uniform(0.1, 0.4), rng.uniform(0.005, 0.03)),
        lambda away, step, incidence, sigma: away * math.sin(step) / math.sin(incidence - step) + 3.0 * sigma,
    ),
    "line": Exercise(("alpha", "d"), _wall, _line),
    "rigid": Exercise(("x, y, theta",), _pairs, _rigid),
    "matches": Exercise(
        ("index of the nearest target", "whether it is near"),
        lambda rng: (points(rng, 9), points(rng, 14), 1.2),
        _matches,
    ),
    "to lines": Exercise(("x, y, theta",), _walls, _to_lines),
    "log odds": Exercise(
        ("log odds",),
        lambda rng: (rng.normal(), rng.uniform(0.1, 0.9), rng.uniform(0.3, 0.45)),
        lambda before, p, prior: before + _odds(p) - _odds(prior),
    ),
    "beam": Exercise(
        ("cells",),
        lambda rng: (rng.uniform(-3.0, 2.0, 2), rng.uniform(4.0, 9.0, 2) * rng.choice([-1.0, 1.0], 2)),
        _beam,
    ),
    "probability": Exercise(
        ("probability",), lambda rng: (rng.normal(0.0, 2.0, 6),), lambda odds: 1.0 / (1.0 + np.exp(-odds))
    ),
    "score": Exercise(
        ("share of points",),
        lambda rng: (rng.uniform(-1.0, 6.0, (40, 2)), mask(rng, 0.4), np.array([-0.3, 0.7]), 0.45),
        _cell_score,
    ),
}

MISTAKES: Mistakes = {
    "returns": {"beams without a return count, too: their range is the largest": lambda d, b, most: _polar(d, b)},
    "gap": {
        "the angle between wall and next beam is smaller, not larger": lambda d, b, i, s: (
            d * math.sin(b) / math.sin(i + b) + 3.0 * s
        ),
        "the noise counts once: three sigmas are asked for": lambda d, b, i, s: d * math.sin(b) / math.sin(i - b) + s,
    },
    "line": {
        "these are the squares in y: a wall may stand upright, use distances across it": _regression,
        "alpha is the direction of the wall, not of its normal": lambda p: _turned_line(p, 0.5 * math.pi, 1.0),
        "d is negative: turn the normal around": lambda p: _turned_line(p, math.pi, -1.0),
    },
    "rigid": {
        "the points' middle is not turned before it is moved": _plain_shift,
        "the middles are not taken off before the turn is found": _not_centred,
    },
    "matches": {
        "every point has a match: those beyond the reach have none": lambda a, b, _: _matches(a, b, math.inf),
        "squared distances are compared with the reach": lambda a, b, reach: _matches(a, b, math.sqrt(reach)),
    },
    "to lines": {
        "the turn moves a point the other way": lambda p, q, n: _to_lines(p, q, n, -1.0),
        "these are distances to the points: only what lies along the normals counts": _to_points,
    },
    "log odds": {
        "the prior counts again with each look": lambda odds, p, prior: odds + _odds(p),
        "a probability is added to log odds": lambda odds, p, prior: odds + p - prior,
        "this is the logarithm of the probability, not of the odds": lambda odds, p, prior: (
            odds + math.log(p) - math.log(prior)
        ),
    },
    "beam": {
        "the last cell is missing": lambda a, b: _beam(a, b)[:-1],
        "as many cells as the longer side has: a beam that crosses a corner's side cuts two": _coarse_beam,
        "rounded: a cell begins at its lower corner": lambda a, b: _beam(a + 0.5, b + 0.5),
    },
    "probability": {"these are the odds": np.exp},
}
