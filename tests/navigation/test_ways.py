"""Cheapest ways over cells with prices, and the cells in which a robot fits."""

import heapq

import numpy as np
import pytest
from test_exploration_states import START, Stage, estimate, rectangle

from sixthsense.core.geometry import Array, Pose
from sixthsense.navigation.exploration_task import TRIES
from sixthsense.navigation.gridsearch import Prices, cheapest_way, costs_from

# A door of 0.54 m, which only the clearance closes to a robot of 0.4 m, or none.
NARROW = np.array([*rectangle(0.0, 0.0, 8.0, 3.0), [[4.0, 0.0], [4.0, 1.23]], [[4.0, 1.77], [4.0, 3.0]]])
CLOSED = np.array([*rectangle(0.0, 0.0, 8.0, 3.0), [[4.0, 0.0], [4.0, 3.0]]])
CLOSER = np.array([*rectangle(0.0, 0.0, 8.0, 3.0), [[4.0, 0.0], [4.0, 1.33]], [[4.0, 1.67], [4.0, 3.0]]])
OPEN = np.array([*rectangle(0.0, 0.0, 8.0, 3.0), [[4.0, 0.0], [4.0, 0.4]], [[4.0, 2.6], [4.0, 3.0]]])
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


def seen_from_both_sides(walls: Array, guarded: bool = True) -> Stage:
    stage = Stage(walls, {"safety": {"guard": guarded}})
    for x in (1.0, 2.5, 3.5, 4.5, 6.0, 7.0):
        stage.see(Pose(x, 1.5, 0.0))
    stage.look(START)
    return stage


def is_open(stage: Stage) -> bool:
    """Whether cells in which the robot fits lead behind the wall."""
    view = stage.exploration._view
    costs = costs_from(view.passable.astype(np.uint8), *view.cell(START.position))
    return bool(costs[view.cell(BEHIND)] >= 0)


@pytest.mark.parametrize(
    ("walls", "guarded", "passed"), [(NARROW, True, True), (NARROW, False, False), (CLOSED, True, False)]
)
def test_a_gap_that_only_the_clearance_closes_is_open_to_a_robot_with_a_guard(
    walls: Array, guarded: bool, passed: bool
) -> None:
    assert is_open(seen_from_both_sides(walls, guarded)) is passed


def passage(width: float, angle: float, length: float) -> Array:
    """Walls of two rooms of 3 m, and of a passage of some width at an angle between them."""
    half, along = 0.5 * length, np.array([np.cos(angle), np.sin(angle)])
    across = np.array([-along[1], along[0]])
    middle = np.array([4.013, 1.487])
    sides = []
    for side in (1.0, -1.0):
        ends = middle + side * 0.5 * width * across + np.outer([-half, half], along)
        rim = np.array([[end[0], 3.0 if side > 0.0 else 0.0] for end in ends])
        sides += [ends, np.array([ends[0], rim[0]]), np.array([ends[1], rim[1]])]
    return np.array([*rectangle(0.0, 0.0, 8.0, 3.0), *sides])


@pytest.mark.parametrize("angle", [0.0, 0.2, 0.47, 0.8])
@pytest.mark.parametrize("length", [0.15, 1.3])
@pytest.mark.parametrize(("width", "passed"), [(0.5, True), (0.45, False)])
def test_a_passage_is_open_if_it_leaves_the_robot_five_centimetres_on_either_side(
    width: float, passed: bool, length: float, angle: float
) -> None:
    stage = Stage(passage(width, angle, length), {"safety": {"guard": True}})
    along = np.array([np.cos(angle), np.sin(angle)])
    for off in (-3.0, -1.6, -1.0, -0.4, 0.3, 0.8, 1.4, 2.8):
        x, y = np.array([4.013, 1.487]) + off * along
        stage.see(Pose(x, min(max(y, 0.4), 2.6), angle))
    stage.look(START)
    assert is_open(stage) is passed


def look_through(stage: Stage, width: float, angle: float, looks: int) -> bool:
    """Look so often through a passage of some width, in place of the stage's walls; whether it is open then."""
    stage.walls = passage(width, angle, 0.4)
    for _ in range(looks):
        for off in (-3.0, -1.6, -1.0, -0.4, 0.3, 0.8, 1.4, 2.8):
            x, y = np.array([4.013, 1.487]) + off * np.array([np.cos(angle), np.sin(angle)])
            stage.see(Pose(x, min(max(y, 0.4), 2.6), angle))
    stage.look(START)
    return is_open(stage)


@pytest.mark.parametrize("angle", [0.2, 0.8])
def test_a_gap_that_was_open_stays_so_while_the_guard_lets_the_robot_through(angle: float) -> None:
    """The guard does between returns that are .44 m apart; .47 m are asked of a gap that was not open."""
    stage, other = (Stage(passage(0.49, angle, 0.4), {"safety": {"guard": True}}) for _ in range(2))
    assert not look_through(other, 0.455, angle, 9)
    assert look_through(stage, 0.49, angle, 3)
    assert look_through(stage, 0.455, angle, 40)
    assert not look_through(stage, 0.41, angle, 80)


def test_whether_a_gap_can_be_passed_does_not_depend_on_where_the_robot_stands() -> None:
    near, far = (seen_from_both_sides(NARROW) for _ in range(2))
    for stage, place in ((near, Pose(3.6, 1.5, 0.0)), (far, Pose(1.0, 2.4, 0.0))):
        stage.exploration._view.redraw(stage.exploration._view.frame)
        stage.exploration.look(stage.grid, estimate(place))
    inside = np.s_[
        near.exploration._view.cell(np.array([3.8, 1.2]))[0] :, near.exploration._view.cell(np.array([3.8, 0.0]))[1] :
    ]
    assert np.array_equal(near.exploration._view.blocked[inside], far.exploration._view.blocked[inside])


def test_a_gap_before_which_the_guard_stops_is_tried_a_few_times_and_then_closed_until_a_wall_moves() -> None:
    stage = seen_from_both_sides(NARROW)
    view = stage.exploration._view
    across = np.array([[3.95, 1.2], [3.95, 1.8]])
    for _ in range(TRIES):
        assert is_open(stage)
        view.count_stop(across)
    assert not is_open(stage)
    stage.walls = OPEN
    for _ in range(60):
        stage.see(Pose(3.5, 1.5, 0.0))
        stage.see(Pose(4.5, 1.5, 0.0))
    stage.look(START)
    assert is_open(stage)


def test_a_robot_fits_where_it_has_been_whatever_is_drawn_there_later() -> None:
    stage = seen_from_both_sides(NARROW)
    for x in (2.0, 3.5, 4.5, 6.0):
        stage.look(Pose(x, 1.5, 0.0))
    stage.walls = CLOSER
    for _ in range(3):
        stage.see(Pose(3.5, 1.5, 0.0))
        stage.see(Pose(4.5, 1.5, 0.0))
    stage.look(Pose(6.0, 1.5, 0.0))
    assert is_open(stage)
    other = seen_from_both_sides(CLOSER)
    assert not is_open(other)
