"""Clearance against plain references: distances, gaps between returns, costs, and what changes."""

import math

import numpy as np
import pytest
from scipy import ndimage

from sixthsense.navigation.clearance import Clearance
from sixthsense.navigation.guard import BUFFER_M
from sixthsense.slam.mapping.changes import Box, Changes

CELL, LEAST, MOST = 0.05, 0.22, 0.52
BOX = Box(-31, 17, 49, 127)


class Points:
    """A grid that has returns, one in a cell, at given places (N, 2), m."""

    def __init__(self, points):
        self.changes, self.box = Changes(), BOX
        self.points = np.asarray(points)
        self.changes.add_all()

    def cells(self):
        return np.floor(self.points[:, ::-1] / CELL).astype(int)

    def obstacle_points(self, box):
        rows, cols = self.cells().T
        return self.points[(rows >= box.top) & (rows < box.bottom) & (cols >= box.left) & (cols < box.right)]

    def part(self, name, box):
        mask = np.zeros((BOX.bottom - BOX.top, BOX.right - BOX.left), dtype=bool)
        if name == "seen":
            mask[:, :70] = True
        else:
            cells = self.cells() - (BOX.top, BOX.left)
            mask[tuple(cells[(cells >= 0).all(axis=1) & (cells < mask.shape).all(axis=1)].T)] = True
        rows, cols = box.within((BOX.top, BOX.left), mask.shape)
        return mask[rows, cols]


def scattered(seed, count=40):
    rng = np.random.default_rng(seed)
    cells = np.unique(rng.integers((BOX.top, BOX.left), (BOX.bottom, BOX.right), (count, 2)), axis=0)
    return (cells[:, ::-1] + rng.uniform(0.02, 0.98, cells.shape)) * CELL


def drawn(grid):
    clearance = Clearance(CELL, LEAST, MOST)
    clearance.update(grid)
    return clearance


def place(clearance, row, col):
    """(2,) where the clearance of a cell is measured, m."""
    down, across = clearance.offsets[row, col]
    return (np.array([col + across, row + down]) + 0.5) * CELL + clearance.origin


@pytest.mark.parametrize("seed", range(4))
def test_the_clearance_of_a_cell_is_the_distance_to_the_nearest_return_from_where_it_is_measured(seed):
    grid = Points(scattered(seed))
    clearance = drawn(grid)
    for row, col in np.ndindex(*clearance.metres.shape):
        at = place(clearance, row, col)
        away = min(np.hypot(*(grid.points - at).T).min(), MOST)
        assert clearance.metres[row, col] == pytest.approx(away, abs=1e-5)
        centre = (np.array([BOX.left + col, BOX.top + row]) + 0.5) * CELL
        assert np.abs(at - centre).max() < 0.5 * CELL
        assert away >= min(np.hypot(*(grid.points - centre).T).min(), MOST) - 1e-6
    assert clearance.offsets.any() and (clearance.offsets == 0.0).all(axis=2).mean() > 0.9


def wall_with_gap(width_m, angle, off):
    """Returns, one in a cell, along a line with a gap of a width about its middle."""
    middle = np.array([3.6, 0.4]) + off
    along = np.array([math.cos(angle), math.sin(angle)])
    steps = np.arange(0.5 * width_m, 7.0, 0.01)
    points = np.concatenate([middle + np.outer(side * steps, along) for side in (-1, 1)])
    order = np.argsort(np.hypot(*(points - middle).T), kind="stable")  # of a cell the return at the gap
    cells = np.floor(points[order] / CELL).astype(int)
    _, first = np.unique(cells, axis=0, return_index=True)
    means = points[order][first]
    return means, middle, np.array([-along[1], along[0]])


def leads_through(clearance, least, middle, across):
    parts, _ = ndimage.label(~(clearance.metres < least))
    sides = [parts[clearance.cell(middle + side * 0.45 * across)] for side in (-1, 1)]
    return sides[0] == sides[1] > 0


@pytest.mark.parametrize("least", [LEAST, LEAST - BUFFER_M])
@pytest.mark.parametrize("angle", [0.0, 0.2, 0.5, 0.8, 1.4])
def test_a_gap_is_as_wide_as_its_returns_are_apart_whichever_way_it_lies_to_the_cells(angle, least):
    rng = np.random.default_rng(round(10 * angle))
    for off in rng.uniform(-CELL, CELL, (20, 2)):
        wide, narrow = (wall_with_gap(2.0 * least + by, angle, off) for by in (0.01, -0.01))
        assert leads_through(drawn(Points(wide[0])), least, *wide[1:])
        assert not leads_through(drawn(Points(narrow[0])), least, *narrow[1:])


def test_what_has_changed_is_drawn_as_if_drawn_anew():
    rng, grid = np.random.default_rng(8), Points(scattered(5, 90))
    clearance = drawn(grid)
    for _ in range(6):
        gone = int(rng.integers(len(grid.points)))
        row, col = grid.cells()[gone].tolist()
        grid.points = np.delete(grid.points, gone, axis=0)
        grid.changes.add(Box(row, col, row + 1, col + 1))
        before = clearance.metres.copy()
        clearance.update(grid)
        assert (clearance.metres != before).any()
        for name in ("metres", "offsets", "obstacles"):
            np.testing.assert_allclose(getattr(clearance, name), getattr(drawn(grid), name), atol=1e-5)


def test_a_metre_costs_more_below_the_clearance_that_is_wished_for_and_is_blocked_below_the_least():
    clearance = drawn(Points(scattered(2)))
    space = clearance.free_space(LEAST, 0.4)
    expected = np.where(clearance.metres < 0.4, (0.4 / clearance.metres) ** 2, 1.0)
    expected[clearance.metres < LEAST] = np.inf
    np.testing.assert_allclose(space.cost, expected, rtol=1e-5)
    assert np.array_equal(space.blocked, clearance.metres < LEAST)
    assert (space.cost > 1.1).sum() > (space.blocked.sum() + 20)


def test_a_robot_in_a_blocked_cell_may_go_where_there_is_no_less_clearance_than_it_has_and_no_other():
    clearance = drawn(Points(scattered(3)))
    near = np.argwhere((clearance.metres > 0.12) & (clearance.metres < 0.15))
    row, col = near[len(near) // 2]
    space = clearance.free_space(LEAST, 0.4, place(clearance, row, col))
    opened = np.argwhere((clearance.metres < LEAST) & ~space.blocked)
    assert (row, col) in map(tuple, opened.tolist())
    assert (clearance.metres[tuple(opened.T)] >= clearance.metres[row, col]).all()
    assert (np.abs(opened - (row, col)) <= math.ceil(0.4 / CELL)).all()
    free = place(clearance, *np.argwhere(clearance.metres > 0.3)[0])
    assert np.array_equal(clearance.free_space(LEAST, 0.4, free).blocked, clearance.metres < LEAST)


def test_cells_far_from_all_seen_ones_are_blocked_for_a_robot_that_drives_through_what_was_seen():
    clearance = drawn(Points(np.array([[1.0, 0.2]])))
    blocked = clearance.free_space(LEAST, 0.4, unseen_m=0.2).blocked
    assert not blocked[:, 60:74].any() and blocked[:, 74:].all()  # the first 70 columns were seen
    assert not clearance.free_space(LEAST, 0.4).blocked[:, 60:].any()
