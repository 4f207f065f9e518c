"""Exercises on grids, paths and exploration."""

from __future__ import annotations

import heapq
import math
from typing import Any

import numpy as np
from scipy import ndimage

from course.drawn import Bools, mask
from course.exercise import Exercise, Judged, Mistakes
from sixthsense.navigation.guard import stopping_distance
from sixthsense.testing import check_explorer

_DIAGONAL = math.sqrt(2.0)


def _beside(cells: Bools, corners: bool = False) -> Bools:
    return np.asarray(ndimage.binary_dilation(cells, ndimage.generate_binary_structure(2, 2 if corners else 1)))


def _octile(rows: int, cols: int) -> float:
    return max(rows, cols) + (_DIAGONAL - 1.0) * min(rows, cols)


def _inflated(obstacles: Bools, radius: float) -> Bools:
    return np.asarray(ndimage.distance_transform_edt(~obstacles) <= radius)


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
        free, start, goal = mask(rng, 0.72), np.array([0, 1]), np.array([7, 11])
        free[tuple(start)] = free[tuple(goal)] = True
        length, cutting = _shortest(free, start, goal), _shortest(free, start, goal, cut=True)
        if cutting < length < math.inf and _shortest(free, start, goal, math.inf) > length:
            return free, start, goal


def _map(rng: np.random.Generator) -> tuple[Bools, Bools]:
    seen = mask(rng, 0.7)
    return seen & mask(rng, 0.7), seen


def _counts(rng: np.random.Generator) -> tuple[Any, ...]:
    hits, ratio = rng.integers(0, 7, (6, 8)), 3
    return hits, np.maximum(hits * ratio + rng.integers(-3, 4, hits.shape), 0), 2, ratio


EXERCISES: dict[str, Exercise | Judged] = {
    "octile": Exercise(("length",), lambda rng: (int(rng.integers(2, 9)), int(rng.integers(10, 30))), _octile),
    "inflate": Exercise(("blocked cells",), lambda rng: (mask(rng, 0.06), rng.uniform(2.05, 2.2)), _inflated),
    "shortest": Exercise(("length",), _maze, _shortest),
    "frontiers": Exercise(("frontier cells",), _map, lambda free, seen: free & _beside(~seen)),
    "coverage": Exercise(
        ("coverage",),
        lambda rng: (mask(rng, 0.6), mask(rng, 0.7)),
        lambda seen, visible: np.count_nonzero(seen & visible) / np.count_nonzero(visible),
    ),
    "explorer": Judged(check_explorer),
    "obstacles": Exercise(
        ("obstacles",), _counts, lambda hits, passes, least, ratio: (hits >= least) & (passes <= ratio * hits)
    ),
    "stopping": Exercise(
        ("distance, m",),
        lambda rng: (rng.uniform(0.2, 1.5), rng.uniform(0.05, 0.4), rng.uniform(0.3, 2.0)),
        stopping_distance,
    ),
}

MISTAKES: Mistakes = {
    "octile": {
        "this is the straight line: a path over cells has eight directions": math.hypot,
        "a step to a diagonal neighbour is one step, not two": lambda rows, cols: rows + cols,
        "a diagonal step is longer than a straight one": max,
    },
    "inflate": {
        "this is a square: the robot is a disc": lambda o, radius: ndimage.binary_dilation(o, np.ones((5, 5))),
        "only neighbours are blocked": lambda o, radius: _beside(o, corners=True),
        "the obstacles themselves are not blocked": lambda o, radius: _inflated(o, radius) & ~o,
    },
    "shortest": {
        "the path cuts corners: both cells beside a diagonal step must be free": lambda f, s, g: _shortest(
            f, s, g, cut=True
        ),
        "a diagonal step is longer than a straight one": lambda f, s, g: _shortest(f, s, g, 1.0),
        "the path turns at right angles only: cells have eight neighbours": lambda f, s, g: _shortest(
            f, s, g, math.inf
        ),
        "blocked cells are crossed": lambda f, s, g: _octile(*np.abs(g - s)),
    },
    "frontiers": {
        "these are unseen cells: a frontier is a free cell, the robot can stand there": lambda f, s: ~s & _beside(f),
        "seen obstacles are no frontier": lambda f, s: s & _beside(~s),
        "a cell has four sides: corners do not count": lambda f, s: f & _beside(~s, corners=True),
        "free cells beside obstacles are no frontier": lambda f, s: f & _beside(~f),
    },
    "coverage": {
        "cells count that cannot be seen from anywhere the robot can be": lambda s, v: s.sum() / v.sum(),
        "this is a share of all cells": lambda s, v: (s & v).sum() / s.size,
    },
    "obstacles": {
        "one hit makes an obstacle for ever: what scans see through is free": lambda h, p, least, ratio: h >= least,
        "stray hits count: a few are asked for": lambda h, p, least, ratio: (h > 0) & (p <= ratio * h),
        "each hit outweighs one pass only": lambda h, p, least, ratio: (h >= least) & (p <= h),
        "equal numbers decide for the obstacle": lambda h, p, least, ratio: (h > least) & (p < ratio * h),
    },
    "stopping": {
        "the speed falls while it brakes: its mean is half": lambda v, delay, a: v * delay + v**2 / a,
        "the braking is missing": lambda v, delay, a: v * delay,
    },
}
