import math
from collections.abc import Callable
from itertools import pairwise

import numpy as np
import pytest
from scipy.ndimage import label
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

from sixthsense.config import GridConfig, RRTStarConfig
from sixthsense.core.geometry import Array, Pose
from sixthsense.core.laser import Scan
from sixthsense.navigation.gridsearch import shortest_path
from sixthsense.navigation.planners import PLANNERS, Plan, Planner, make_planner
from sixthsense.navigation.planners.astar import AStar
from sixthsense.navigation.planners.shortcut import furthest_visible, path_is_free, shortcut
from sixthsense.slam.mapping.freespace import FreeSpace
from sixthsense.slam.mapping.grid import Grid

CELL = 0.1
ORIGIN = (-1.3, 2.1)


def space_of(blocked: Array) -> FreeSpace:
    return FreeSpace(blocked, np.zeros(blocked.shape, dtype=bool), ORIGIN, CELL)


def space_from_text(text: str) -> FreeSpace:
    """A space from a picture: # is blocked, the bottom line is row 0."""
    rows = [[mark == "#" for mark in line.strip()] for line in text.strip().splitlines()]
    return space_of(np.array(rows[::-1]))


def noise(rng: np.random.Generator) -> Array:
    return rng.random((25, 31)) < rng.uniform(0.05, 0.45)


def blocks(rng: np.random.Generator) -> Array:
    blocked = np.zeros((40, 33), dtype=bool)
    for _ in range(12):
        r, c = rng.integers(0, 33, 2)
        h, w = rng.integers(1, 12, 2)
        blocked[r : r + h, c : c + w] = True
    return blocked


def maze(rng: np.random.Generator) -> Array:
    """A perfect maze (depth-first) with a few walls removed, so that several paths differ in length."""
    blocked = np.ones((31, 31), dtype=bool)
    stack = [(1, 1)]
    blocked[1, 1] = False
    while stack:
        r, c = stack[-1]
        steps = [(r + a, c + b) for a, b in ((0, 2), (0, -2), (2, 0), (-2, 0))]
        steps = [(p, q) for p, q in steps if 0 < p < 31 and 0 < q < 31 and blocked[p, q]]
        if not steps:
            stack.pop()
            continue
        p, q = steps[rng.integers(len(steps))]
        blocked[p, q] = blocked[(r + p) // 2, (c + q) // 2] = False
        stack.append((p, q))
    blocked[rng.integers(1, 30, 25), rng.integers(1, 30, 25)] = False
    return blocked


WORLDS = [noise, blocks, maze]


def random_free_point(rng: np.random.Generator, space: FreeSpace) -> Array:
    row, col = rng.permutation(np.argwhere(~space.blocked))[0]
    return space.centre(int(row), int(col)) + rng.uniform(-0.49, 0.49, 2) * CELL


def touches_blocked(space: FreeSpace, path_world: Array) -> bool:
    """An independent checker: dense samples along the path, each looked up by itself."""
    for a, b in pairwise(path_world):
        count = 2 + int(np.linalg.norm(b - a) / (CELL / 50))
        samples = a + np.linspace(0.0, 1.0, count)[:, None] * (b - a)
        cols, rows = np.floor((samples - ORIGIN) / CELL).astype(int).T
        inside = (rows >= 0) & (rows < space.blocked.shape[0]) & (cols >= 0) & (cols < space.blocked.shape[1])
        if space.blocked[rows[inside], cols[inside]].any():
            return True
    return False


def dijkstra_costs(blocked: Array, source: tuple[int, int]) -> Array:
    """Costs in cells from `source` to every cell; diagonal steps need both cells beside them free."""
    height, width = blocked.shape
    index = np.arange(height * width).reshape(height, width)
    free = ~blocked
    tails, heads, costs = [], [], []
    for dr, dc in ((0, 1), (1, 0), (1, 1), (1, -1)):
        a = np.s_[: height - dr, max(-dc, 0) : width - max(dc, 0)]
        b = np.s_[dr:, max(dc, 0) : width - max(-dc, 0)]
        passable = free[a] & free[b]
        if dr and dc:
            beside_1 = np.s_[dr:, max(-dc, 0) : width - max(dc, 0)]
            beside_2 = np.s_[: height - dr, max(dc, 0) : width - max(-dc, 0)]
            passable &= free[beside_1] & free[beside_2]
        tails.append(index[a][passable])
        heads.append(index[b][passable])
        costs.append(np.full(passable.sum(), math.hypot(dr, dc)))
    graph = coo_array(
        (np.concatenate(costs), (np.concatenate(tails), np.concatenate(heads))), shape=(height * width,) * 2
    )
    return dijkstra(graph.tocsr(), directed=False, indices=index[source]).reshape(height, width)


# Small worlds with narrow passages: short steps, and more of them than there are cells.
VARIANTS = {
    "astar": ("astar", None),
    "rrtstar": ("rrtstar", RRTStarConfig(informed=False, iterations=2000)),
    "informed-rrtstar": ("rrtstar", RRTStarConfig(informed=True, iterations=2000)),
}


@pytest.fixture(params=VARIANTS)
def variant(request: pytest.FixtureRequest) -> str:
    name: str = request.param
    return name


@pytest.fixture
def planner(variant: str) -> Planner:
    name, options = VARIANTS[variant]
    return make_planner(name, options=options)


def test_the_contract_is_tested_for_every_planner() -> None:
    assert {name for name, _ in VARIANTS.values()} == set(PLANNERS)


# The contract of every planner, by the numbers of its docstring.


@pytest.mark.parametrize("seed", range(12))
@pytest.mark.parametrize("world", WORLDS)
def test_a_path_joins_start_and_goal_through_free_cells_at_the_cost_it_says(
    planner: Planner, variant: str, world: Callable[[np.random.Generator], Array], seed: int
) -> None:
    rng = np.random.default_rng(seed)
    space = space_of(world(rng))
    start, goal = random_free_point(rng, space), random_free_point(rng, space)
    plan = planner.plan(space, start, goal)
    regions, _ = label(~space.blocked)
    joined = regions[space.cell_of(start)] == regions[space.cell_of(goal)]
    if joined and variant != "astar" and plan.status == "gave up":
        assert_without_path(plan, "gave up")  # 5: a path through a maze takes more samples than the budget
        assert plan.expanded == 2000
        return
    assert plan.status == ("found" if joined else "no path")
    if not joined:
        return
    path = plan.path_world
    assert len(path) >= 2 and (path[0] == start).all() and (path[-1] == goal).all()  # 1
    assert not touches_blocked(space, path) and path_is_free(space, path)  # 2
    assert plan.cost == pytest.approx(np.hypot(*np.diff(path, axis=0).T).sum(), abs=1e-9)  # 3
    assert plan.found
    with pytest.raises(ValueError, match="read-only"):
        path[0] = 0.0


def test_start_and_goal_may_lie_outside_the_known_grid(planner: Planner, variant: str) -> None:
    space = space_from_text("""
        .......
        .#####.
        .#...#.
        .#.#.#.
        ...#...
        """)
    outside = [(3.0, 7.0), (-6.0, 2.32), (-0.97, -1.0), (-0.97, 2.35)]
    for start in outside:
        for goal in outside:
            plan = planner.plan(space, start, goal)
            if variant != "astar" and plan.status == "gave up":
                assert outside[3] in (start, goal)  # behind a gap of one cell in thousands
                continue
            assert plan.found and (plan.path_world[[0, -1]] == [start, goal]).all()
            assert not touches_blocked(space, plan.path_world)
    empty = FreeSpace(np.zeros((0, 0), dtype=bool), np.zeros((0, 0), dtype=bool), (0.0, 0.0), CELL)
    assert planner.plan(empty, (5.0, 5.0), (7.0, 4.0)).found


def assert_without_path(plan: Plan, status: str) -> None:
    assert plan.status == status and not plan.found
    assert plan.path_world.shape == (0, 2) and plan.cost == math.inf


def test_what_stands_in_the_way_is_named(planner: Planner) -> None:
    space = space_from_text("""
        .......
        .#####.
        .#...#.
        .#.#.#.
        .#...#.
        .#####.
        .......
        """)
    outside, inside, wall, pillar = (space.centre(*cell) for cell in ((0, 0), (2, 2), (1, 3), (3, 3)))
    assert_without_path(planner.plan(space, wall, outside), "start blocked")
    assert_without_path(planner.plan(space, wall, pillar), "start blocked")
    assert_without_path(planner.plan(space, inside, pillar), "goal blocked")
    assert_without_path(planner.plan(space, (50.0, 50.0), pillar), "goal blocked")
    assert_without_path(planner.plan(space, outside, inside), "no path")
    assert_without_path(planner.plan(space, inside, outside), "no path")
    assert_without_path(planner.plan(space, inside, (5.0, -5.0)), "no path")


def test_a_start_that_is_the_goal_is_a_path_of_no_length(planner: Planner) -> None:
    space = space_from_text("""
        ..#
        #..
        """)
    for point in ((-1.0, 2.13), space.centre(0, 1), (90.0, -90.0)):
        plan = planner.plan(space, point, point)
        assert plan.found and plan.cost == 0.0
        assert np.array_equal(plan.path_world, [point, point])
    near = planner.plan(space, (-1.13, 2.11), (-1.19, 2.18))
    assert near.found and near.cost == pytest.approx(math.hypot(0.06, 0.07))


def test_a_start_on_the_edge_of_a_blocked_cell_gives_a_free_path(planner: Planner) -> None:
    blocked = np.zeros((8, 8), dtype=bool)
    blocked[:6, 3] = True
    space = FreeSpace(blocked, blocked, (0.0, 0.0), 0.25)
    plan = planner.plan(space, (1.0, 0.25), (0.5, 0.5))
    assert plan.found and path_is_free(space, plan.path_world)


def test_the_same_question_has_the_same_answer(planner: Planner, variant: str) -> None:
    rng = np.random.default_rng(11)
    for world in WORLDS:
        space = space_of(world(rng))
        start, goal = random_free_point(rng, space), random_free_point(rng, space)
        first, again = planner.plan(space, start, goal), planner.plan(space, start, goal)
        name, options = VARIANTS[variant]
        other = make_planner(name, options=options).plan(space, start, goal)
        assert first.status == again.status == other.status and first.expanded == other.expanded
        assert np.array_equal(first.path_world, again.path_world)
        assert np.array_equal(first.path_world, other.path_world)


@pytest.mark.parametrize("bad", [(1.0,), (1.0, 2.0, 3.0), (math.nan, 0.0), (0.0, -math.inf)])
def test_a_start_or_goal_that_is_no_point_is_refused_by_name(planner: Planner, bad: tuple[float, ...]) -> None:
    space = space_of(np.zeros((3, 3), dtype=bool))
    with pytest.raises(ValueError, match="start"):
        planner.plan(space, bad, (0.0, 0.0))
    with pytest.raises(ValueError, match="goal"):
        planner.plan(space, (0.0, 0.0), bad)


def test_an_unknown_planner_lists_the_known_ones() -> None:
    with pytest.raises(ValueError, match=r"found 'dstar', did you mean astar\? allowed: astar, rrtstar"):
        make_planner("dstar")


# A*


@pytest.mark.parametrize("seed", range(60))
@pytest.mark.parametrize("world", WORLDS)
def test_a_star_costs_what_dijkstra_finds(world: Callable[[np.random.Generator], Array], seed: int) -> None:
    rng = np.random.default_rng(1000 + seed)
    blocked = world(rng)
    free = rng.permutation(np.argwhere(~blocked))
    source = (int(free[0][0]), int(free[0][1]))
    costs = dijkstra_costs(blocked, source)
    for row, col in free[:12].tolist():
        cells, cost, expanded = shortest_path(blocked, source, (row, col))
        assert cost == costs[row, col] or abs(cost - costs[row, col]) < 1e-9
        if cost == math.inf:
            assert cells.shape == (0, 2)
            continue
        assert cells[0].tolist() == list(source) and cells[-1].tolist() == [row, col]
        steps = np.diff(cells, axis=0)
        assert (np.abs(steps).max(axis=1, initial=0) == 1).all()
        assert np.hypot(*steps.T).sum() == pytest.approx(cost, abs=1e-9)
        assert not blocked[tuple(cells.T)].any()
        beside = np.stack([cells[:-1, 0], cells[1:, 1]]), np.stack([cells[1:, 0], cells[:-1, 1]])
        assert not blocked[tuple(beside[0])].any() and not blocked[tuple(beside[1])].any()  # no corner is cut
        assert expanded <= 2 * len(free)


def test_a_star_on_centres_costs_the_cells_and_the_way_to_the_centres() -> None:
    rng = np.random.default_rng(4)
    space = space_of(blocks(rng))
    for _ in range(20):
        start, goal = random_free_point(rng, space), random_free_point(rng, space)
        plan = AStar().plan(space, start, goal)
        costs = dijkstra_costs(space.blocked, space.cell_of(start))[space.cell_of(goal)]
        first, last = space.centre(*space.cell_of(start)), space.centre(*space.cell_of(goal))
        if plan.found and space.cell_of(start) != space.cell_of(goal):
            ends = np.linalg.norm(start - first) + np.linalg.norm(goal - last)
            assert plan.cost == pytest.approx(costs * CELL + ends, abs=1e-9)
        else:
            assert plan.found or costs == math.inf


def test_a_star_does_not_squeeze_between_two_cells_that_meet_at_a_corner() -> None:
    space = space_from_text("""
        ..#.
        ..#.
        ##..
        ....
        """)
    a, b = space.centre(3, 0), space.centre(0, 3)
    assert_without_path(AStar().plan(space, a, b), "no path")
    beside = AStar().plan(space_from_text("..\n.#"), space.centre(0, 0), space.centre(1, 1))
    assert beside.cost == pytest.approx(2 * CELL)


def test_the_way_round_an_obstacle_may_lead_through_the_unknown() -> None:
    grid = Grid(GridConfig(cell_m=CELL), 0.1)
    wall = np.array([[[1.0, -0.9], [1.0, 0.9]]])
    scan = Scan(np.full(1, np.inf, dtype=np.float32), np.float32(0.0), np.float32(0.1), 0.5)
    grid.add(Pose(), scan, wall)
    start, goal = np.zeros(2), np.array([2.0, 0.0])
    plan = AStar().plan(grid.free_space(start, goal), start, goal)
    assert plan.found and np.abs(plan.path_world[:, 1]).max() > 0.9


# Short cuts


@pytest.mark.parametrize("seed", range(25))
@pytest.mark.parametrize("world", WORLDS)
def test_a_short_cut_keeps_the_ends_touches_nothing_and_is_no_longer(
    world: Callable[[np.random.Generator], Array], seed: int
) -> None:
    rng = np.random.default_rng(500 + seed)
    space = space_of(world(rng))
    plan = AStar().plan(space, random_free_point(rng, space), random_free_point(rng, space))
    short = shortcut(space, plan.path_world)
    if not plan.found:
        assert short.shape == (0, 2)
        return
    assert (short[[0, -1]] == plan.path_world[[0, -1]]).all()
    assert {tuple(p) for p in short} <= {tuple(p) for p in plan.path_world}
    assert np.linalg.norm(np.diff(short, axis=0), axis=1).sum() <= plan.cost + 1e-9
    assert path_is_free(space, short) and not touches_blocked(space, short)
    for i in range(len(short) - 2):  # each is the furthest visible: nothing later on the path is
        later = np.flatnonzero((plan.path_world == short[i + 1]).all(axis=1))[-1] + 1
        assert not any(space.line_is_free(short[i], point) for point in plan.path_world[later:])


def test_in_the_open_the_short_cut_is_the_straight_line() -> None:
    space = space_of(np.zeros((30, 30), dtype=bool))
    plan = AStar().plan(space, space.centre(2, 3), space.centre(25, 11))
    assert np.array_equal(shortcut(space, plan.path_world), plan.path_world[[0, -1]])
    assert furthest_visible(space, plan.path_world[0], plan.path_world, 1) == len(plan.path_world) - 1


def test_a_robot_within_the_inflation_aims_for_the_next_way_point_alone() -> None:
    space = space_from_text("""
        ......
        .#....
        ......
        """)
    path = np.array([space.centre(0, c) for c in range(6)])
    assert furthest_visible(space, space.centre(1, 1), path, 2) == 2
    assert furthest_visible(space, space.centre(1, 2), path, 2) == 5
    assert not path_is_free(space, np.array([space.centre(1, 1), *path[2:]]))
    assert furthest_visible(space, space.centre(0, 0), path, 5) == 5
    with pytest.raises(ValueError, match="index: found 6, allowed: 0 to 5"):
        furthest_visible(space, space.centre(0, 0), path, 6)


def test_a_new_obstacle_on_the_path_is_noticed_and_one_beside_it_is_not() -> None:
    blocked = np.zeros((9, 9), dtype=bool)
    path = np.array([space_of(blocked).centre(4, 0), space_of(blocked).centre(4, 8)])
    assert path_is_free(space_of(blocked), path)
    for row, col in np.ndindex(9, 9):
        hit = blocked.copy()
        hit[row, col] = True
        assert path_is_free(space_of(hit), path) == (row != 4)
        assert path_is_free(space_of(hit), path[:1]) == ((row, col) != (4, 0))
    assert path_is_free(space_of(blocked), path[:0])
    with pytest.raises(ValueError, match="path_world"):
        path_is_free(space_of(blocked), path[0])
