"""Exercises on grids, paths and exploration."""

from __future__ import annotations

import heapq
import math
from typing import Any

import numpy as np
from scipy import ndimage

from course.drawn import Bools, mask
from course.exercise import Exercise, Judged, Mistake, verdict

_DIAGONAL = math.sqrt(2.0)
_CROSS: Bools = np.array([[0, 1, 0], [1, 1, 1], [0, 1, 0]], dtype=np.bool_)


def _octile(rows: int, cols: int) -> float:
    return max(rows, cols) + (_DIAGONAL - 1.0) * min(rows, cols)


def _disc(radius: float) -> Bools:
    reach = math.floor(radius)
    r, c = np.mgrid[-reach : reach + 1, -reach : reach + 1]
    return np.asarray(np.hypot(r, c) <= radius)


def _inflated(obstacles: Bools, radius: float) -> Bools:
    return np.asarray(ndimage.binary_dilation(obstacles, _disc(radius)))


def _shortest(free: Bools, start: Any, goal: Any, diagonal: float = _DIAGONAL, cut: bool = False) -> float:
    """Dijkstra's search over cells with eight neighbours, or with `diagonal` infinite four."""
    best, queue = {tuple(start): 0.0}, [(0.0, tuple(start))]
    while queue:
        cost, (r, c) = heapq.heappop(queue)
        if (r, c) == tuple(goal):
            return cost
        for dr, dc in ((-1, -1), (-1, 0), (-1, 1), (0, -1), (0, 1), (1, -1), (1, 0), (1, 1)):
            to = r + dr, c + dc
            inside = 0 <= to[0] < free.shape[0] and 0 <= to[1] < free.shape[1]
            if not inside or not free[to] or not (cut or (free[r + dr, c] and free[r, c + dc])):
                continue
            length = cost + (diagonal if dr and dc else 1.0)
            if length < best.get(to, math.inf):
                best[to] = length
                heapq.heappush(queue, (length, to))
    return math.inf


def _maze(rng: np.random.Generator) -> tuple[Any, ...]:
    """A grid in which the ways of all the mistakes differ."""
    while True:
        free = mask(rng, 0.72)
        start, goal = np.array([0, 1]), np.array([7, 11])
        free[tuple(start)] = free[tuple(goal)] = True
        length, cutting = _shortest(free, start, goal), _shortest(free, start, goal, cut=True)
        if cutting < length < math.inf and _shortest(free, start, goal, math.inf) > length:
            return free, start, goal


def _frontiers(free: Bools, seen: Bools, neighbours: Bools = _CROSS) -> Bools:
    return np.asarray(free & ndimage.binary_dilation(~seen, neighbours))


def _map(rng: np.random.Generator) -> tuple[Bools, Bools]:
    seen = mask(rng, 0.7)
    return seen & mask(rng, 0.7), seen


def _counts(rng: np.random.Generator) -> tuple[Any, ...]:
    hits = rng.integers(0, 7, (6, 8))
    ratio = 3
    passes = hits * ratio + rng.integers(-3, 4, hits.shape)
    return hits, np.maximum(passes, 0), 2, ratio


def _obstacles(hits: Any, passes: Any, least: int, ratio: float) -> Bools:
    return np.asarray((hits >= least) & (passes <= ratio * hits))


def _judge_explorer(explorer: Any) -> str:
    from sixthsense.testing import check_explorer

    return verdict(check_explorer(explorer))


EXERCISES = (
    Exercise(
        "octile",
        ("length",),
        lambda rng: (int(rng.integers(2, 9)), int(rng.integers(10, 30))),
        _octile,
        (
            Mistake("this is the straight line: a path over cells has eight directions", lambda r, c: math.hypot(r, c)),
            Mistake("a step to a diagonal neighbour is one step, not two", lambda r, c: r + c),
            Mistake("a diagonal step is longer than a straight one", lambda r, c: max(r, c)),
        ),
    ),
    Exercise(
        "inflate",
        ("blocked cells",),
        lambda rng: (mask(rng, 0.06), rng.uniform(2.05, 2.2)),
        _inflated,
        (
            Mistake(
                "this is a square: the robot is a disc",
                lambda o, radius: ndimage.binary_dilation(o, np.ones((5, 5), dtype=np.bool_)),
            ),
            Mistake("only neighbours are blocked", lambda o, radius: _inflated(o, 1.5)),
            Mistake("the obstacles themselves are not blocked", lambda o, radius: _inflated(o, radius) & ~o),
        ),
    ),
    Exercise(
        "shortest",
        ("length",),
        _maze,
        _shortest,
        (
            Mistake(
                "the path cuts corners: both cells beside a diagonal step must be free",
                lambda f, s, g: _shortest(f, s, g, cut=True),
            ),
            Mistake("a diagonal step is longer than a straight one", lambda f, s, g: _shortest(f, s, g, 1.0)),
            Mistake(
                "the path turns at right angles only: cells have eight neighbours",
                lambda f, s, g: _shortest(f, s, g, math.inf),
            ),
            Mistake("blocked cells are crossed", lambda f, s, g: _octile(*np.abs(g - s))),
        ),
    ),
    Exercise(
        "frontiers",
        ("frontier cells",),
        _map,
        _frontiers,
        (
            Mistake(
                "these are unseen cells: a frontier is a free cell, the robot can stand there",
                lambda f, s: ~s & ndimage.binary_dilation(f, _CROSS),
            ),
            Mistake("seen obstacles are no frontier", lambda f, s: _frontiers(s, s)),
            Mistake(
                "a cell has four sides: corners do not count",
                lambda f, s: _frontiers(f, s, np.ones((3, 3), dtype=np.bool_)),
            ),
            Mistake("free cells beside obstacles are no frontier", lambda f, s: _frontiers(f, f)),
        ),
    ),
    Exercise(
        "coverage",
        ("coverage",),
        lambda rng: (mask(rng, 0.6), mask(rng, 0.7)),
        lambda seen, visible: np.count_nonzero(seen & visible) / np.count_nonzero(visible),
        (
            Mistake("cells count that cannot be seen from anywhere the robot can be", lambda s, v: s.sum() / v.sum()),
            Mistake("this is a share of what was seen, not of what can be seen", lambda s, v: (s & v).sum() / s.sum()),
            Mistake("this is a share of all cells", lambda s, v: (s & v).sum() / s.size),
        ),
    ),
    Judged("explorer", _judge_explorer),
    Exercise(
        "obstacles",
        ("obstacles",),
        _counts,
        _obstacles,
        (
            Mistake(
                "one hit makes an obstacle for ever: what scans see through is free",
                lambda h, p, least, ratio: h >= least,
            ),
            Mistake("stray hits count: a few are asked for", lambda h, p, least, ratio: (h > 0) & (p <= ratio * h)),
            Mistake("each hit outweighs one pass only", lambda h, p, least, ratio: _obstacles(h, p, least, 1.0)),
            Mistake("equal numbers decide for the obstacle", lambda h, p, least, ratio: (h > least) & (p < ratio * h)),
        ),
    ),
    Exercise(
        "stopping",
        ("distance, m",),
        lambda rng: (rng.uniform(0.2, 1.5), rng.uniform(0.05, 0.4), rng.uniform(0.3, 2.0)),
        lambda speed, delay, braking: speed * delay + speed**2 / (2.0 * braking),
        (
            Mistake("the robot drives on until it has noticed", lambda v, delay, a: v**2 / (2.0 * a)),
            Mistake("the speed falls while it brakes: its mean is half", lambda v, delay, a: v * delay + v**2 / a),
            Mistake("the braking is missing", lambda v, delay, a: v * delay),
        ),
    ),
)
