"""Tours through views: short, by ways that pass no wall, and the first stop."""

import itertools

import numpy as np
import pytest

from sixthsense.core.geometry import Array
from sixthsense.navigation.gridsearch import costs_from
from sixthsense.navigation.gridsearch.prices import STRAIGHT
from sixthsense.navigation.tour import TileWays, short_tour, stop_order, tour_length, view_order
from sixthsense.slam.mapping.freespace import Bools


def between(points: Array) -> Array:
    return np.asarray(np.hypot(*(points[:, None] - points).transpose(2, 0, 1)))


def ways_over(free: Bools) -> TileWays:
    ways = TileWays(6)
    ways.update(free)
    return ways


@pytest.mark.parametrize("seed", range(20))
def test_a_tour_visits_each_stop_once_and_is_nearly_the_shortest(seed: int) -> None:
    lengths = between(np.random.default_rng(seed).uniform(0.0, 100.0, (8, 2)))
    tour = short_tour(lengths)
    assert tour[0] == 0 and tour[-1] == 7 and sorted(tour) == list(range(8))
    shortest = min(tour_length(lengths, np.array([0, *order, 7])) for order in itertools.permutations(range(1, 7)))
    assert tour_length(lengths, tour) <= 1.05 * shortest


def test_what_lies_on_the_way_home_is_left_for_the_way_home() -> None:
    # The robot stands at 0, home is at the left, and a stop to either side: the right one is first.
    lengths = between(np.array([(0.0, 0.0), (-4.0, 0.0), (5.0, 0.0), (-20.0, 0.0)]))
    assert stop_order(lengths).tolist() == [2, 1]


def test_stops_that_no_way_leads_to_come_last() -> None:
    lengths = between(np.array([(0.0, 0.0), (1.0, 0.0), (9.0, 0.0), (0.0, 1.0)]))
    lengths[1, :] = lengths[:, 1] = np.inf
    assert stop_order(lengths).tolist() == [2, 1]


def test_the_only_view_is_the_first() -> None:
    free = np.ones((12, 12), dtype=np.bool_)
    assert view_order(ways_over(free), (2, 2), np.array([(9, 9)]), (2, 2)).tolist() == [0]


def test_a_view_without_a_way_over_the_tiles_is_no_stop_of_a_tour_home() -> None:
    """The last view on the left lies on the way home; one behind a wall would leave the end of the tour open."""
    free = np.ones((12, 120), dtype=np.bool_)
    free[:, 100:108] = False
    views = np.array([(6, 31), (7, 80), (5, 115)])
    assert view_order(ways_over(free), (6, 50), views, (6, 3)).tolist() == [1, 0]
    assert view_order(ways_over(free), (6, 50), views[2:], (6, 3)).tolist() == [0]


@pytest.mark.parametrize("seed", range(5))
def test_ways_over_tiles_are_nearly_those_over_cells(seed: int) -> None:
    rng = np.random.default_rng(seed)
    free = np.ones((90, 120), dtype=np.bool_)
    for row in (10, 31, 53, 74):  # walls thicker than a tile, with a door each
        door = rng.integers(6, 110)
        free[row : row + 7] = False
        free[row : row + 7, door : door + 8] = True
    cells = np.argwhere(free)[rng.integers(np.count_nonzero(free), size=6)]
    lengths = ways_over(free).matrix(cells)
    prices = free.astype(np.uint8)
    exact = np.array([costs_from(prices, *cell)[tuple(cells.T)] for cell in cells.tolist()]) / STRAIGHT
    assert (np.abs(lengths - exact) <= 0.15 * exact + 12.0).all()


def test_a_wall_between_two_tiles_parts_them() -> None:
    free = np.ones((12, 18), dtype=np.bool_)
    free[:, 5:11] = False
    assert np.isinf(ways_over(free).lengths((0, 0), np.array([(0, 17)]))[0])
