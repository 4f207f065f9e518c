"""Prices of cells, cheapest ways, and the dear ones that are opened."""

import heapq

import numpy as np
import pytest
from test_exploration_states import RADIUS, START, Stage, rectangle

from sixthsense.config import merge
from sixthsense.core.geometry import Array, Pose
from sixthsense.navigation.gridsearch import Prices, cheapest_way, costs_from
from sixthsense.navigation.ways import Ways

# A door of 0.54 m, which only the clearance closes to a robot of 0.4 m, or none.
NARROW = np.array([*rectangle(0.0, 0.0, 8.0, 3.0), [[4.0, 0.0], [4.0, 1.23]], [[4.0, 1.77], [4.0, 3.0]]])
CLOSED = np.array([*rectangle(0.0, 0.0, 8.0, 3.0), [[4.0, 0.0], [4.0, 3.0]]])
BEHIND = np.array([6.0, 1.5])


def plain_costs(prices: Prices, start: tuple[int, int]) -> Array:
    costs = np.full(prices.shape, np.inf)
    queue = [(0, *start)]
    while queue:
        cost, row, col = heapq.heappop(queue)
        if cost >= costs[row, col]:
            continue
        costs[row, col] = cost
        for down in (-1, 0, 1):
            for across in (-1, 0, 1):
                r, c = row + down, col + across
                if not (0 <= r < prices.shape[0] and 0 <= c < prices.shape[1]) or (r, c) == (row, col):
                    continue
                passed = prices[[row, r, r], [c, col, c]] if down * across else prices[r, [c]]
                if passed.all():
                    heapq.heappush(queue, (cost + (7 if down and across else 5) * int(passed.max()), r, c))
    return costs


@pytest.mark.parametrize("seed", range(5))
def test_costs_are_those_of_a_plain_search_and_ways_cost_what_they_say(seed: int) -> None:
    rng = np.random.default_rng(seed)
    prices = rng.choice(np.array([0, 1, 10, 30], dtype=np.uint8), (30, 40), p=[0.3, 0.5, 0.1, 0.1])
    costs, plain = costs_from(prices, 5, 7), plain_costs(prices, (5, 7))
    assert np.array_equal(np.where(costs < 0, np.inf, costs), plain)
    for row, col in np.argwhere(costs > 0)[::37].tolist():
        way = cheapest_way(prices, costs, row, col)
        assert way[0].tolist() == [5, 7] and way[-1].tolist() == [row, col]
        steps = np.abs(np.diff(way, axis=0)).sum(axis=1)
        (r, c), (to_r, to_c) = way[:-1].T, way[1:].T
        passed = np.max([prices[to_r, to_c], prices[r, to_c], prices[to_r, c]], axis=0, where=(steps == 2), initial=0)
        dearest = np.maximum(passed, prices[to_r, to_c]).astype(int)
        assert costs[row, col] == np.sum(np.where(steps == 2, 7, 5) * dearest)
    assert len(cheapest_way(prices, costs, *np.argwhere(costs < 0)[0].tolist())) == 0


def seen_from_both_sides(walls: Array) -> Stage:
    stage = Stage(walls)
    for x in (1.0, 2.5, 3.5, 4.5, 6.0, 7.0):
        stage.see(Pose(x, 1.5, 0.0))
    stage.look(START)
    return stage


def way_behind(stage: Stage, ways: Ways) -> bool:
    """Open the cheapest way to behind the wall; whether there is one."""
    view = stage.exploration._view
    view.draw_views(view.cell(START.position))
    prices = ways.prices(view.frame, view.passable, view.free & view.blocked, stage.grid)
    way = cheapest_way(prices, costs_from(prices, *view.cell(START.position)), *view.cell(BEHIND))
    if len(way):
        ways.open(way + np.array(view.first), prices[tuple(way.T)])
    return len(way) > 0


def is_open(stage: Stage, ways: Ways) -> bool:
    """Whether free cells lead behind the wall."""
    box, view = stage.grid.box, stage.exploration._view
    blocked = stage.grid.part("cover", box) > 0
    ways.unblock(blocked, box, stage.grid)
    here, there = (tuple(np.add(view.cell(point), view.first) - box[:2]) for point in (START.position, BEHIND))
    return bool(costs_from((~blocked).astype(np.uint8), *here)[there] >= 0)


@pytest.mark.parametrize(("walls", "guarded"), [(CLOSED, True), (NARROW, False)])
def test_no_way_leads_through_a_wall_or_without_the_guard(walls: Array, guarded: bool) -> None:
    stage = seen_from_both_sides(walls)
    assert not way_behind(stage, Ways(RADIUS, merge(stage.config, {"safety": {"guard": guarded}})))


def test_a_way_that_was_not_come_through_is_refused_after_a_few_tries() -> None:
    stage = seen_from_both_sides(NARROW)
    ways = Ways(RADIUS, stage.config)
    assert not is_open(stage, ways)
    for _ in range(stage.config.explore.tries):
        assert way_behind(stage, ways) and is_open(stage, ways)
        ways.close_untried()
    assert not is_open(stage, ways) and not way_behind(stage, ways)


def test_ways_that_the_robot_has_come_through_stay_open_one_beside_the_other() -> None:
    stage = seen_from_both_sides(NARROW)
    ways = Ways(RADIUS, stage.config)
    way_behind(stage, ways)
    ways.moved(np.array([4.25, 1.5]))
    way_behind(stage, ways)
    ways.close_untried()
    assert is_open(stage, ways)


def test_no_open_way_leads_over_cells_of_obstacles() -> None:
    stage = seen_from_both_sides(NARROW)
    ways = Ways(RADIUS, stage.config)
    way_behind(stage, ways)
    for _ in range(3):
        stage.walls = CLOSED
        stage.see(Pose(3.5, 1.5, 0.0))
    assert not is_open(stage, ways)
