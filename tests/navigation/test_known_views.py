"""What is remembered of views would be found again."""

import math

import numpy as np
import pytest

from sixthsense.navigation.known_views import KnownViews, View
from sixthsense.navigation.viewpoints import Viewpoints

REACH = 6.5


@pytest.mark.parametrize("seed", range(5))
def test_what_is_remembered_would_be_found_again_however_the_map_has_changed(seed: int) -> None:
    rng, views = np.random.default_rng(seed), KnownViews()
    obstacles, reachable = rng.random((60, 70)) < 0.2, rng.random((60, 70)) < 0.02
    first, found, hidden = (0, 0), 0, 0
    for turn in range(30):
        if turn == 15:  # the map grows
            obstacles, reachable = (np.pad(mask, ((2, 5), (3, 0))) for mask in (obstacles, reachable))
            first = -2, -3
        changed = obstacles if rng.random() < 0.5 else reachable
        row, col = rng.integers(55), rng.integers(65)
        changed[row : row + 3, col : col + 3] = rng.random((3, 3)) < 0.1
        views.update(first, (reachable.copy(), obstacles.copy()))
        viewpoints = Viewpoints(reachable, obstacles, REACH)
        for row, col in rng.integers(60, size=(40, 2)).tolist():
            view, known = viewpoints.nearest((row, col)), views.get((row, col))
            assert known is None or known.cell == view
            found += known is not None and view is not None
            hidden += known is not None and view is None
            span = int(REACH) if view is None else math.ceil(math.dist(view, (row, col)))
            views.add((row, col), View(view, 1, span))
    assert found > 20 and hidden > 20


def test_a_map_that_does_not_hold_the_one_before_is_another() -> None:
    views, mask = KnownViews(), np.zeros((20, 20), dtype=np.bool_)
    views.update((0, 0), (mask,))
    views.add((3, 4), View(None, 0, 2))
    views.update((0, 0), (mask,))
    assert views.get((3, 4)) is not None
    views.update((-1, 0), (np.zeros((21, 20), dtype=np.bool_),))
    assert views.get((3, 4)) is None and views.get((4, 4)) is not None
    views.update((0, 1), (mask,))
    assert views.get((4, 3)) is None and views.get((4, 4)) is None


def test_small_views_are_ignored_up_to_the_dust_until_the_map_around_them_changes() -> None:
    views, mask = KnownViews(), np.zeros((60, 60), dtype=np.bool_)
    views.update((0, 0), (mask,))
    cells = [(5, 5), (5, 50), (50, 5)]
    for cell, shown in zip(cells, (9, 4, 3), strict=True):
        views.add(cell, View(cell, shown, 2))
    assert views.worthwhile(cells, 2.0) == [2, 1, 0]
    assert views.worthwhile(cells, 5.0) == [1, 0]
    views.add((5, 5), View((5, 5), 1, 2))  # the rest of a view that has been seen
    assert views.worthwhile(cells, 5.0) == [1]
    reachable = mask.copy()
    reachable[50, 6] = True
    views.update((0, 0), (reachable,))
    views.add((50, 5), View((50, 6), 9, 2))
    assert views.worthwhile(cells, 3.5) == [1, 2]
