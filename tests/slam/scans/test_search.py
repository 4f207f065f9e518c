"""Submaps, branch and bound."""

import math

import numpy as np
import pytest
from rooms import scan_at, stored

from sixthsense.core.geometry import Pose
from sixthsense.slam.scans.places import (
    BLOCK,
    CELL_M,
    PEAK,
    PLACE,
    STEP_RAD,
    Apart,
    Window,
    peaks,
    pyramid,
    surfaces,
)


@pytest.fixture(scope="module")
def room():
    scans = [Pose(-1.0, 0.5, 0.0), Pose(0.0, -1.0, 1.0), Pose(-3.0, 1.0, 2.0)]
    store = stored(*(scan_at(pose) for pose in scans))
    poses = np.array([pose.array() for pose in scans])
    return np.ascontiguousarray(surfaces(store.returns, np.arange(3), poses)[:, :2])


def brute_force(cells, points, window):
    """The best score in the window, and the score of each heading, column and row."""
    values, n = cells.values.astype(float), int(window.half_m / CELL_M)
    scores = {}
    turns = int(window.half_rad / STEP_RAD)
    for a in range(-turns, turns + 1):
        x, y, theta = window.centre + np.array([0, 0, a * STEP_RAD])
        c, s = math.cos(theta), math.sin(theta)
        at = np.floor((points @ np.array([[c, s], [-s, c]]) + [x - cells.x0, y - cells.y0]) / CELL_M).astype(int)
        for dx in range(-n, n + 1):
            for dy in range(-n, n + 1):
                i, j = (at + np.array([dx, dy])).T
                inside = (i >= 0) & (j >= 0) & (i < values.shape[0]) & (j < values.shape[1])
                scores[a, dx, dy] = values[i[inside], j[inside]].sum() / (PEAK * len(points))
    return scores


@pytest.mark.parametrize(("seed", "most"), [(0, 64), (1, 64), (2, 1), (3, 3)])
def test_places_are_the_best_cells_of_blocks_that_are_apart(room, seed, most):
    rng = np.random.default_rng(seed)
    points = room[rng.choice(len(room), 90, replace=False)] - rng.uniform(-1, 1, 2)
    window, cells, apart = Window(rng.uniform(-1, 1, 3) * [1.0, 1.0, 0.1], 1.3, 0.1), pyramid(room), Apart(0.7, 0.06)
    n = int(window.half_m / CELL_M)
    best = {}
    for (a, dx, dy), score in brute_force(cells, points, window).items():
        best.setdefault((a, (dx + n) // BLOCK, (dy + n) // BLOCK), []).append((-score, a, dx, dy))
    expected = []
    for score, a, dx, dy in sorted(min(block) for block in best.values()):
        pose = window.centre + np.array([dx * CELL_M, dy * CELL_M, a * STEP_RAD])
        is_near = [np.hypot(*(p[1:3] - pose[:2])) < 0.7 - 1e-9 and abs(p[3] - pose[2]) < 0.06 - 1e-9 for p in expected]
        if -score > 0.15 and len(expected) < most and not any(is_near):
            expected.append(np.array([-score, *pose]))
    found = peaks(cells, points, window, 0.15, apart, most)
    assert len(expected) >= min(most, 4)
    assert found == pytest.approx(np.array(expected), abs=1e-9)


def test_a_scan_of_many_thousand_returns_fits_where_it_was_taken(room):
    """More points than two bytes can sum: they stand for each other."""
    pose = Pose(0.31, -0.22, 0.17)
    own = pose.inverse() @ room
    window, cells = Window(pose.array() + np.array([0.2, -0.1, 0.03]), 0.8, 0.1), pyramid(room)
    many = peaks(cells, np.repeat(own, 1 + 40000 // len(own), axis=0), window, 0.2, PLACE, 16)
    few = peaks(cells, own, window, 0.2, PLACE, 16)
    assert many[0] == pytest.approx(few[0], abs=0.01)
    assert many[0, 1:3] == pytest.approx(pose.position, abs=2 * CELL_M)
