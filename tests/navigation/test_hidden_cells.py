"""What is remembered as hidden would be found hidden again."""

from dataclasses import replace

import numpy as np
import pytest

from sixthsense.navigation.hidden_cells import HiddenCells
from sixthsense.navigation.map_window import MapWindow
from sixthsense.navigation.viewpoints import Viewpoints

REACH = 6.5


def window_of(obstacles):
    none = np.zeros_like(obstacles)
    return MapWindow((0, 0), 0.05, ~obstacles, obstacles, obstacles, none)


@pytest.mark.parametrize("seed", range(5))
def test_what_is_remembered_would_be_found_again_however_the_map_has_changed(seed):
    rng, hidden = np.random.default_rng(seed), HiddenCells(REACH)
    obstacles, reachable = rng.random((60, 70)) < 0.2, rng.random((60, 70)) < 0.02
    remembered = kept = 0
    for _ in range(30):
        changed = obstacles if rng.random() < 0.5 else reachable
        row, col = rng.integers(55), rng.integers(65)
        changed[row : row + 3, col : col + 3] = rng.random((3, 3)) < 0.1
        hidden.update(window_of(obstacles.copy()), reachable.copy())
        viewpoints = Viewpoints(reachable, obstacles, REACH)
        for cell in rng.integers(60, size=(40, 2)).tolist():
            view, known = viewpoints.nearest((cell[0], cell[1])), hidden.view(*cell)
            assert not (view is not None and hidden.has(*cell))
            assert known is None or known == (view, 1)
            remembered += hidden.has(*cell)
            kept += known is not None
            if view is None:
                hidden.add(*cell)
            else:
                hidden.keep(*cell, (view, 1))
    assert remembered > 20 and kept > 20


def test_a_window_with_another_corner_is_remembered_anew():
    hidden, window = HiddenCells(REACH), window_of(np.zeros((20, 20), dtype=np.bool_))
    hidden.update(window, window.obstacles)
    hidden.add(3, 4)
    hidden.update(window, window.obstacles)
    assert hidden.has(3, 4)
    hidden.update(replace(window, first=(0, 1)), window.obstacles)
    assert not hidden.has(3, 4)


def test_a_cell_that_is_hidden_from_everywhere_is_hidden_from_where_the_robot_can_be():
    hidden, window = HiddenCells(REACH), window_of(np.zeros((40, 40), dtype=np.bool_))
    hidden.update(window, window.obstacles)
    hidden.add(3, 4)
    hidden.add(30, 31, everywhere=True)
    assert hidden.has(3, 4) and not hidden.has(3, 4, everywhere=True)
    assert hidden.has(30, 31) and hidden.has(30, 31, everywhere=True)
    changed = window.obstacles.copy()
    changed[31, 31] = True
    hidden.update(window_of(changed), window.obstacles)
    assert hidden.has(3, 4) and not hidden.has(30, 31, everywhere=True)


def test_small_views_are_ignored_up_to_the_dust_until_the_map_around_them_changes():
    hidden, window = HiddenCells(REACH), window_of(np.zeros((60, 60), dtype=np.bool_))
    hidden.update(window, window.obstacles)
    cells = [(5, 5), (5, 50), (50, 5)]
    for cell, shown in zip(cells, (9, 4, 3), strict=True):
        hidden.keep(*cell, (cell, shown))
    assert hidden.worthwhile(cells, 2.0) == [2, 1, 0]
    assert hidden.worthwhile(cells, 5.0) == [1, 0]
    hidden.keep(5, 5, ((5, 5), 1))  # the rest of a view that has been seen
    assert hidden.worthwhile(cells, 5.0) == [1]
    reachable = window.obstacles.copy()
    reachable[50, 6] = True
    hidden.update(window, reachable)
    hidden.keep(50, 5, ((50, 6), 9))
    assert hidden.worthwhile(cells, 3.5) == [1, 2]
