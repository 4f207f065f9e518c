import numpy as np
import pytest
from test_planners import CELL, WORLDS, dijkstra_costs, random_free_point, space_of

from sixthsense.core.geometry import Array
from sixthsense.navigation.gridsearch import CostTree
from sixthsense.navigation.planners.astar import AStar
from sixthsense.slam.mapping.freespace import FreeSpace


def changed(rng: np.random.Generator, blocked: Array, keep: tuple[int, int]) -> Array:
    """The same cells with a few boxes blocked or freed, `keep` left free."""
    after = blocked.copy()
    for _ in range(rng.integers(0, 6)):
        row, col = rng.integers(0, blocked.shape[0]), rng.integers(0, blocked.shape[1])
        height, width = rng.integers(1, 5, 2)
        after[row : row + height, col : col + width] = rng.random() < 0.5
    after[keep] = False
    return after


def random_free_cell(rng: np.random.Generator, blocked: Array) -> tuple[int, int]:
    row, col = rng.permutation(np.argwhere(~blocked))[0].tolist()
    return row, col


@pytest.mark.parametrize("seed", range(20))
@pytest.mark.parametrize("world", WORLDS)
def test_a_repaired_tree_has_the_costs_of_dijkstra_however_often_cells_are_blocked_and_freed(world, seed: int) -> None:
    rng = np.random.default_rng(2000 + seed)
    blocked = world(rng)
    goal = random_free_cell(rng, blocked)
    tree, start = CostTree(blocked, goal), random_free_cell(rng, blocked)
    for _ in range(10):
        blocked = changed(rng, blocked, goal)
        tree.update(blocked)
        if blocked[start] or rng.random() < 0.5:
            start = random_free_cell(rng, blocked)
        cost, _ = tree.reach(start)
        expected = dijkstra_costs(blocked, goal)[start]
        assert cost == expected or abs(cost - expected) < 1e-9
        if cost == np.inf:
            continue
        cells = tree.path(start)
        assert tuple(cells[0]) == start and tuple(cells[-1]) == goal
        assert np.hypot(*np.diff(cells, axis=0).T).sum() == pytest.approx(cost, abs=1e-9)
        assert not blocked[tuple(cells.T)].any()
        assert not blocked[cells[:-1, 0], cells[1:, 1]].any() and not blocked[cells[1:, 0], cells[:-1, 1]].any()


def test_what_has_not_changed_is_not_searched_again() -> None:
    tree = CostTree(np.zeros((40, 40), dtype=bool), (35, 35))
    first = tree.reach((2, 3))
    assert first[1] > 0
    tree.update(np.zeros((40, 40), dtype=bool))
    assert tree.reach((2, 3)) == (first[0], 0)
    assert tree.reach((35, 35)) == (0.0, 0)


def rooms() -> Array:
    """Nine rooms with a door between neighbours."""
    blocked = np.zeros((120, 120), dtype=bool)
    for k in (40, 80):
        blocked[k, :] = blocked[:, k] = True
    for k in (20, 60, 100):
        for door in (40, 80):
            blocked[door, k - 3 : k + 3] = blocked[k - 3 : k + 3, door] = False
    return blocked


def test_a_replan_around_a_new_obstacle_is_as_short_as_one_from_scratch_and_expands_less() -> None:
    blocked = rooms()
    before = space_of(blocked)
    planner, start, goal = AStar(), before.centre(5, 5), before.centre(110, 112)
    first = planner.plan(before, start, goal)
    robot = first.path_world[5]
    row, col = before.cell_of(first.path_world[25])
    blocked[row - 2 : row + 3, col - 2 : col + 3] = True
    after = space_of(blocked)
    again, scratch = planner.plan(after, robot, goal), AStar().plan(after, robot, goal)
    assert again.cost == pytest.approx(scratch.cost, abs=1e-9)
    assert again.expanded < scratch.expanded
    assert planner.plan(before, start, goal).cost == pytest.approx(first.cost, abs=1e-9)  # the obstacle is gone again


def test_another_goal_another_grid_and_a_grid_that_has_grown_are_planned_from_scratch() -> None:
    rng = np.random.default_rng(5)
    planner = AStar()
    for _ in range(30):
        blocked = WORLDS[int(rng.integers(3))](rng)
        origin = (float(rng.integers(-3, 3)) * CELL, 0.0)
        space = FreeSpace(blocked, np.zeros_like(blocked), origin, float(rng.choice([CELL, 2 * CELL])))
        start, goal = (space.centre(*random_free_cell(rng, blocked)) for _ in range(2))
        for asked in (space, space.covering(start + 50.0 * CELL * rng.uniform(-1, 1, 2)), space):
            plan, scratch = planner.plan(asked, start, goal), AStar().plan(asked, start, goal)
            assert plan.status == scratch.status
            assert plan.cost == scratch.cost or plan.cost == pytest.approx(scratch.cost, abs=1e-9)


def test_a_goal_that_was_blocked_for_a_while_is_reached_when_it_is_free_again() -> None:
    free = np.zeros((20, 20), dtype=bool)
    space = space_of(free)
    start, goal = space.centre(2, 2), space.centre(15, 15)
    planner = AStar()
    first = planner.plan(space, start, goal)
    blocked = free.copy()
    blocked[14:17, 14:17] = True
    assert planner.plan(space_of(blocked), start, goal).status == "goal blocked"
    blocked[15, 15] = False
    assert planner.plan(space_of(blocked), start, goal).status == "no path"
    assert planner.plan(space, start, goal).cost == first.cost


def test_a_random_walk_of_replans_keeps_the_contract() -> None:
    rng = np.random.default_rng(6)
    blocked = WORLDS[1](rng)
    goal = space_of(blocked)
    end = random_free_point(rng, goal)
    planner = AStar()
    for _ in range(40):
        blocked = changed(rng, blocked, goal.cell_of(end))
        space = space_of(blocked)
        start = random_free_point(rng, space)
        plan, scratch = planner.plan(space, start, end), AStar().plan(space, start, end)
        assert plan.status == scratch.status
        if plan.found:
            assert plan.cost == pytest.approx(scratch.cost, abs=1e-9)
            assert (plan.path_world[[0, -1]] == [start, end]).all()
