"""Tours through views: short, and the first stop."""

import itertools

import numpy as np
import pytest

from sixthsense.core.geometry import Array
from sixthsense.navigation.tour import stop_order


def tour_length(lengths: Array, tour: Array) -> float:
    return float(lengths[tour[:-1], tour[1:]].sum())


def between(points: Array) -> Array:
    return np.asarray(np.hypot(*(points[:, None] - points).transpose(2, 0, 1)))


@pytest.mark.parametrize("seed", range(20))
def test_a_tour_visits_each_stop_once_and_is_nearly_the_shortest(seed: int) -> None:
    lengths = between(np.random.default_rng(seed).uniform(0.0, 100.0, (8, 2)))
    order = stop_order(lengths)
    assert sorted(order) == list(range(1, 7))
    shortest = min(tour_length(lengths, np.array([0, *stops, 7])) for stops in itertools.permutations(range(1, 7)))
    assert tour_length(lengths, np.array([0, *order, 7])) <= 1.15 * shortest


def test_what_lies_on_the_way_home_is_left_for_the_way_home() -> None:
    # The robot stands at 0, home is at the left, and a stop to either side: the right one is first.
    lengths = between(np.array([(0.0, 0.0), (-4.0, 0.0), (5.0, 0.0), (-20.0, 0.0)]))
    assert stop_order(lengths).tolist() == [2, 1]


def test_stops_that_no_way_leads_to_come_last() -> None:
    lengths = between(np.array([(0.0, 0.0), (1.0, 0.0), (9.0, 0.0), (0.0, 1.0)]))
    lengths[1, :] = lengths[:, 1] = np.inf
    assert stop_order(lengths).tolist() == [2, 1]


def test_the_only_view_is_the_first() -> None:
    assert stop_order(between(np.array([(0.0, 0.0), (2.0, 1.0), (0.0, 0.0)]))).tolist() == [1]
