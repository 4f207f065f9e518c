"""Exercises on scans: features, alignment, occupancy."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from course.drawn import mask, points
from course.exercise import Exercise, Mistake
from sixthsense.core.geometry import Array, rotation


def _scan(rng: np.random.Generator) -> tuple[Any, ...]:
    ranges, most = rng.uniform(0.5, 7.0, 12), 8.0
    ranges[rng.choice(12, 3, replace=False)] = most
    return ranges, np.linspace(-2.0, 1.7, 12), most


def _returns(ranges: Array, bearings: Array, most: float) -> Array:
    seen = ranges < most
    return np.column_stack([ranges * np.cos(bearings), ranges * np.sin(bearings)])[seen]


def _gap(away: float, step: float, incidence: float, sigma: float) -> float:
    return away * math.sin(step) / math.sin(incidence - step) + 3.0 * sigma


def _wall(rng: np.random.Generator) -> tuple[Array]:
    alpha, d = rng.uniform(-3.0, 3.0), rng.uniform(0.8, 4.0)
    along = np.sort(rng.uniform(-3.0, 1.0, 9))
    local = np.column_stack([d + 0.2 * rng.standard_normal(9), along])
    return (local @ rotation(alpha).T,)


def _line(places: Array) -> tuple[float, float]:
    middle = places.mean(axis=0)
    nx, ny = np.linalg.svd(places - middle)[2][1]
    d = float(nx * middle[0] + ny * middle[1])
    return (math.atan2(ny, nx), d) if d >= 0.0 else (math.atan2(-ny, -nx), -d)


def _regression(places: Array) -> tuple[float, float]:
    slope, offset = np.polyfit(places[:, 0], places[:, 1], 1)
    alpha, d = math.atan2(1.0, -slope), offset / math.hypot(1.0, slope)
    return (alpha, d) if d >= 0.0 else (math.atan2(-1.0, slope), -d)


def _negative(places: Array) -> tuple[float, float]:
    alpha, d = _line(places)
    return math.remainder(alpha + math.pi, 2.0 * math.pi), -d


def _along(places: Array) -> tuple[float, float]:
    alpha, d = _line(places)
    return math.remainder(alpha + 0.5 * math.pi, 2.0 * math.pi), d


def _pairs(rng: np.random.Generator) -> tuple[Array, Array]:
    targets = points(rng, 7)
    moved = targets @ rotation(rng.uniform(-3.0, 3.0)).T + rng.uniform(-3.0, 3.0, 2)
    return moved + 0.1 * rng.standard_normal((7, 2)), targets


def _rigid(places: Array, targets: Array) -> Array:
    a, b = places - places.mean(axis=0), targets - targets.mean(axis=0)
    theta = math.atan2(float(np.sum(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])), float(np.sum(a * b)))
    return np.array([*(targets.mean(axis=0) - rotation(theta) @ places.mean(axis=0)), theta])


def _plain_shift(places: Array, targets: Array) -> Array:
    return np.array([*(targets.mean(axis=0) - places.mean(axis=0)), _rigid(places, targets)[2]])


def _not_centred(a: Array, b: Array) -> Array:
    theta = math.atan2(float(np.sum(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])), float(np.sum(a * b)))
    return np.array([*(b.mean(axis=0) - rotation(theta) @ a.mean(axis=0)), theta])


def _walls(rng: np.random.Generator) -> tuple[Array, Array, Array]:
    places, angles = points(rng, 8), rng.uniform(-3.0, 3.0, 8)
    return places, places + 0.1 * rng.standard_normal((8, 2)), np.column_stack([np.cos(angles), np.sin(angles)])


def _to_lines(places: Array, targets: Array, normals: Array, lever: float = 1.0, sign: float = 1.0) -> Array:
    turned = lever * np.column_stack([-places[:, 1], places[:, 0]])
    A = np.column_stack([normals, np.sum(normals * turned, axis=1)])
    return np.asarray(np.linalg.lstsq(A, sign * np.sum(normals * (targets - places), axis=1))[0])


def _to_points(places: Array, targets: Array, normals: Array) -> Array:
    turned = np.column_stack([-places[:, 1], places[:, 0]])
    A = np.concatenate([np.column_stack([np.tile(e, (len(places), 1)), turned @ e]) for e in np.eye(2)])
    return np.asarray(np.linalg.lstsq(A, (targets - places).T.ravel())[0])


def _matches(places: Array, targets: Array, reach_m: float) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    off = np.linalg.norm(places[:, None] - targets[None], axis=2)
    return off.argmin(axis=1), off.min(axis=1) < reach_m


def _some(rng: np.random.Generator) -> tuple[Array, Array, float]:
    return points(rng, 9), points(rng, 14), 1.2


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


def _crossing(rng: np.random.Generator) -> tuple[Array, Array]:
    return rng.uniform(-3.0, 2.0, 2), rng.uniform(4.0, 9.0, 2) * rng.choice([-1.0, 1.0], 2)


def _cell_score(places: Array, occupied: Array, origin: Array, cell_m: float) -> float:
    cols, rows = np.floor((places - origin) / cell_m).astype(int).T
    inside = (rows >= 0) & (cols >= 0) & (rows < occupied.shape[0]) & (cols < occupied.shape[1])
    return float(occupied[rows[inside], cols[inside]].sum() / len(places))


def _score_case(rng: np.random.Generator) -> tuple[Any, ...]:
    return rng.uniform(-1.0, 6.0, (40, 2)), mask(rng, 0.4), np.array([-0.3, 0.7]), 0.45


EXERCISES = (
    Exercise(
        "returns",
        ("points",),
        _scan,
        _returns,
        (
            Mistake(
                "the beams without a return count, too: their range is the largest",
                lambda d, b, most: np.column_stack([d * np.cos(b), d * np.sin(b)]),
            ),
            Mistake("x and y are exchanged: bearing 0 is forward, along x", lambda d, b, m: _returns(d, b, m)[:, ::-1]),
            Mistake("bearings are in radians", lambda d, b, m: _returns(d, np.radians(b), m)),
        ),
    ),
    Exercise(
        "gap",
        ("largest distance",),
        lambda rng: (rng.uniform(0.5, 9.0), rng.uniform(0.004, 0.03), rng.uniform(0.1, 0.4), rng.uniform(0.005, 0.03)),
        _gap,
        (
            Mistake("the noise of the range is missing", lambda d, b, i, s: _gap(d, b, i, 0.0)),
            Mistake(
                "the angle between wall and next beam is smaller, not larger",
                lambda d, b, i, s: d * math.sin(b) / math.sin(i + b) + 3.0 * s,
            ),
            Mistake("the noise counts once: three sigmas are asked for", lambda d, b, i, s: _gap(d, b, i, s / 3.0)),
        ),
    ),
    Exercise(
        "line",
        ("alpha", "d"),
        _wall,
        _line,
        (
            Mistake("these are the squares in y: a wall may stand upright, use distances across it", _regression),
            Mistake("alpha is the direction of the wall, not of its normal", _along),
            Mistake(
                "d is negative: turn the normal around",
                _negative,
            ),
        ),
    ),
    Exercise(
        "rigid",
        ("x, y, theta",),
        _pairs,
        _rigid,
        (
            Mistake("this is the motion of the targets to the points, turn it around", lambda a, b: _rigid(b, a)),
            Mistake("the points' middle is not turned before it is moved", _plain_shift),
            Mistake("the middles are not taken off before the turn is found", _not_centred),
        ),
    ),
    Exercise(
        "matches",
        ("index of the nearest target", "whether it is near"),
        _some,
        _matches,
        (
            Mistake(
                "every point has a match: those beyond the reach have none",
                lambda a, b, reach: (_matches(a, b, reach)[0], np.ones(len(a))),
            ),
            Mistake(
                "squared distances are compared with the reach", lambda a, b, reach: _matches(a, b, math.sqrt(reach))
            ),
        ),
    ),
    Exercise(
        "to lines",
        ("x, y, theta",),
        _walls,
        _to_lines,
        (
            Mistake("the turn moves a point the other way", lambda p, q, n: _to_lines(p, q, n, lever=-1.0)),
            Mistake("the step leads away from the targets", lambda p, q, n: _to_lines(p, q, n, sign=-1.0)),
            Mistake("these are distances to the points: only what lies along the normals counts", _to_points),
        ),
    ),
    Exercise(
        "log odds",
        ("log odds",),
        lambda rng: (rng.normal(), rng.uniform(0.1, 0.9), rng.uniform(0.3, 0.45)),
        lambda before, p, prior: before + _odds(p) - _odds(prior),
        (
            Mistake("the prior counts again with each look", lambda odds, p, prior: odds + _odds(p)),
            Mistake("a probability is added to log odds", lambda odds, p, prior: odds + p - prior),
            Mistake(
                "this is the logarithm of the probability, not of the odds",
                lambda odds, p, prior: odds + math.log(p) - math.log(prior),
            ),
        ),
    ),
    Exercise(
        "beam",
        ("cells",),
        _crossing,
        _beam,
        (
            Mistake("the last cell is missing", lambda a, b: _beam(a, b)[:-1]),
            Mistake("as many cells as the longer side has: a beam that crosses a corner's side cuts two", _coarse_beam),
            Mistake("rounded: a cell begins at its lower corner", lambda a, b: _beam(a + 0.5, b + 0.5)),
            Mistake("from the end to the start", lambda a, b: _beam(a, b)[::-1]),
        ),
    ),
    Exercise(
        "probability",
        ("probability",),
        lambda rng: (rng.normal(0.0, 2.0, 6),),
        lambda odds: 1.0 / (1.0 + np.exp(-odds)),
        (
            Mistake("these are the odds", lambda odds: np.exp(odds)),
            Mistake("this is the probability that the cell is free", lambda odds: 1.0 / (1.0 + np.exp(odds))),
        ),
    ),
    Exercise(
        "score",
        ("share of points",),
        _score_case,
        _cell_score,
        (
            Mistake(
                "rows and columns are exchanged: grids are indexed [row = y, col = x]",
                lambda p, g, o, c: _cell_score(p, g.T, o, c),
            ),
            Mistake(
                "rows and columns are exchanged: grids are indexed [row = y, col = x]",
                lambda p, g, o, c: _cell_score(p[:, ::-1], g, o[::-1], c),
            ),
            Mistake("the grid's corner is not taken off", lambda p, g, o, c: _cell_score(p, g, 0.0 * o, c)),
        ),
    ),
)
