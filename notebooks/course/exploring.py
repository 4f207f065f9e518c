"""Exercises on grids, paths and exploration."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from scipy import ndimage

from course.drawn import Bools, mask
from course.exercise import Exercise, Judged
from sixthsense.navigation.guard import stopping_distance
from sixthsense.testing import check_explorer


def _beside(cells: Bools, corners: bool = False) -> Bools:
    return np.asarray(ndimage.binary_dilation(cells, ndimage.generate_binary_structure(2, 2 if corners else 1)))


def _maze(rng: np.random.Generator) -> tuple[Any, ...]:
    free, start, goal = mask(rng, 0.78), np.array([0, 1]), np.array([7, 11])
    free[tuple(start)] = free[tuple(goal)] = True
    return free, start, goal


def _map(rng: np.random.Generator) -> tuple[Bools, Bools]:
    seen = mask(rng, 0.7)
    return seen & mask(rng, 0.7), seen


def _counts(rng: np.random.Generator) -> tuple[Any, ...]:
    hits, ratio = rng.integers(0, 7, (6, 8)), 3
    return hits, np.maximum(hits * ratio + rng.integers(-3, 4, hits.shape), 0), 2, ratio


EXERCISES: dict[str, Exercise | Judged] = {
    "octile": Exercise(
        ("length",),
        lambda rng: (int(rng.integers(2, 9)), int(rng.integers(10, 30))),
        mistakes={
            "this is the straight line: a path over cells has eight directions": lambda _, *off: math.hypot(*off),
            "a step to a diagonal neighbour is one step, not two": lambda _, rows, cols: rows + cols,
            "a diagonal step is longer than a straight one": lambda _, *off: max(off),
        },
    ),
    "inflate": Exercise(
        ("blocked cells",),
        lambda rng: (mask(rng, 0.06), rng.uniform(2.05, 2.2)),
        mistakes={
            "this is a square: the robot is a disc": lambda _, o, r: ndimage.binary_dilation(o, np.ones((5, 5), bool)),
            "the obstacles themselves are not blocked": lambda right, o, radius: right(o, radius) & ~o,
        },
    ),
    "shortest": Exercise(("length",), _maze),
    "frontiers": Exercise(
        ("frontier cells",),
        _map,
        mistakes={
            "these are unseen cells: a frontier is a free cell, the robot can stand there": lambda _, f, s: (
                ~s & _beside(f)
            ),
            "seen obstacles are no frontier": lambda _, f, s: s & _beside(~s),
            "a cell has four sides: corners do not count": lambda _, f, s: f & _beside(~s, corners=True),
        },
    ),
    "coverage": Exercise(
        ("coverage",),
        lambda rng: (mask(rng, 0.6), mask(rng, 0.7)),
        mistakes={
            "cells count that cannot be seen from anywhere the robot can be": lambda _, s, v: s.sum() / v.sum(),
            "this is a share of all cells": lambda _, s, v: (s & v).sum() / s.size,
        },
    ),
    "explorer": Judged(check_explorer),
    "obstacles": Exercise(
        ("obstacles",),
        _counts,
        mistakes={
            "one hit makes an obstacle for ever: what scans see through is free": lambda _, h, p, n, ratio: h >= n,
            "stray hits count: a few are asked for": lambda right, h, p, n, ratio: right(h, p, 1, ratio),
            "each hit outweighs one pass only": lambda right, h, p, n, ratio: right(h, p, n, 1),
        },
    ),
    "stopping": Exercise(
        ("distance, m",),
        lambda rng: (rng.uniform(0.2, 1.5), rng.uniform(0.05, 0.4), rng.uniform(0.3, 2.0)),
        stopping_distance,
        {
            "the speed falls while it brakes: its mean is half": lambda right, v, delay, a: right(v, delay, 0.5 * a),
            "the braking is missing": lambda _, v, delay, a: v * delay,
        },
    ),
}
