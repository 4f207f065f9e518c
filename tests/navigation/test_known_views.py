"""What is remembered of views would be found again."""

import math

import numpy as np
import pytest

from sixthsense.navigation.viewpoints import Viewpoints
from sixthsense.navigation.views import KnownViews, View

REACH = 6.5


@pytest.mark.parametrize("seed", range(5))
def test_what_is_remembered_would_be_found_again_however_the_map_has_changed(seed: int) -> None:
    rng, views = np.random.default_rng(seed), KnownViews()
    obstacles, reachable = rng.random((64, 72)) < 0.2, rng.random((64, 72)) < 0.02
    first, found, hidden = np.zeros(2, dtype=np.int64), 0, 0
    for turn in range(30):
        shape = np.array(obstacles.shape) // 8
        tiles = np.zeros(shape, dtype=np.bool_)
        if turn == 15:  # the map grows
            obstacles, reachable = (np.pad(mask, ((8, 8), (16, 0))) for mask in (obstacles, reachable))
            first, tiles = np.array([-8, -16]), np.ones(np.add(shape, 2), dtype=np.bool_)
            tiles[1:-1, 2:] = False
        changed = obstacles if rng.random() < 0.5 else reachable
        row, col = rng.integers(55), rng.integers(65)
        changed[row : row + 3, col : col + 3] = rng.random((3, 3)) < 0.1
        tiles[row // 8 : (row + 2) // 8 + 1, col // 8 : (col + 2) // 8 + 1] = True
        views.forget(tiles, (int(first[0]), int(first[1])))
        viewpoints = Viewpoints(reachable, obstacles, REACH)
        for row, col in rng.integers(60, size=(40, 2)).tolist():
            key = row + int(first[0]), col + int(first[1])
            view, known = viewpoints.nearest((row, col)), views.get(key)
            expected = None if view is None else (view[0] + int(first[0]), view[1] + int(first[1]))
            assert known is None or known.cell == expected
            found += known is not None and view is not None
            hidden += known is not None and view is None
            span = int(REACH) if view is None else math.ceil(math.dist(view, (row, col)))
            views.add(key, View(expected, 1, span))
    assert found > 20 and hidden > 20


def test_small_views_are_ignored_up_to_the_dust_until_the_map_around_them_changes() -> None:
    views, changed = KnownViews(), np.zeros((8, 8), dtype=np.bool_)
    cells = [(5, 5), (5, 50), (50, 5)]
    for cell, shown in zip(cells, (9, 4, 3), strict=True):
        views.add(cell, View(cell, shown, 2))
    assert views.worthwhile(cells, 2.0) == [2, 1, 0]
    assert views.worthwhile(cells, 5.0) == [1, 0]
    views.add((5, 5), View((5, 5), 1, 2))  # the rest of a view that has been seen
    assert views.worthwhile(cells, 5.0) == [1]
    changed[6, 0] = True
    views.forget(changed, (0, 0))
    assert views.get((50, 5)) is None
    views.add((50, 5), View((50, 6), 9, 2))
    assert views.worthwhile(cells, 3.5) == [1, 2]


def test_a_view_that_was_counted_until_it_was_enough_is_counted_anew_when_more_may_be_left() -> None:
    whole, cut = View((5, 7), 13, 2, 26.0), View((5, 7), 27, 2, 26.0)
    assert whole.is_known_beyond(12.9) and whole.is_known_beyond(90.0)
    assert cut.is_known_beyond(26.9) and not cut.is_known_beyond(27.0)
