import itertools
import math
from collections.abc import Callable
from itertools import pairwise

import numpy as np
import pytest
from scipy.ndimage import label

from sixthsense.config import RRTStarConfig
from sixthsense.core.geometry import Array
from sixthsense.navigation.planners import PLANNERS, Plan, Planner, make_planner
from sixthsense.navigation.planners.astar import AStar
from sixthsense.navigation.planners.shortcut import is_free, shortcut
from sixthsense.slam.mapping.freespace import FreeSpace
from sixthsense.testing import planner_checks

CELL = 0.1
ORIGIN = (-1.3, 2.1)


def space_of(blocked: Array, cost: Array | None = None) -> FreeSpace:
    free = np.ones(blocked.shape) if cost is None else cost
    cost = np.where(blocked, np.inf, free).astype(np.float32)
    return FreeSpace(blocked, np.zeros(blocked.shape, dtype=bool), ORIGIN, CELL, cost)


def dear(rng: np.random.Generator, blocked: Array) -> Array:
    return rng.choice([1.0, 1.0, 3.5], blocked.shape)


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


WORLDS = [noise, blocks]


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


def path_is_free(space: FreeSpace, path_world: Array) -> bool:
    return bool(is_free(space.blocked, space.offsets, space.in_cells(path_world), np.inf))


# Small worlds with narrow passages: short steps, and more of them than there are cells.
SAMPLES = 2000


@pytest.fixture(params=PLANNERS)
def planner(request: pytest.FixtureRequest) -> Planner:
    options = RRTStarConfig(iterations=SAMPLES) if request.param == "rrtstar" else None
    return make_planner(request.param, options=options)


LAWS = {f"{part}: {name}": check for part in PLANNERS for name, check in planner_checks(part)}


@pytest.mark.parametrize("law", [law if "astar" in law else pytest.param(law, marks=pytest.mark.slow) for law in LAWS])
def test_shipped_planners_keep_the_laws_of_their_contract(law: str) -> None:
    LAWS[law]()


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("world", WORLDS)
def test_a_path_joins_start_and_goal_through_free_cells_at_the_cost_it_says(
    planner: Planner, world: Callable[[np.random.Generator], Array], seed: int
) -> None:
    """By a dense look-up of its own; the numbers are those of the contract."""
    rng = np.random.default_rng(seed)
    blocked = world(rng)
    space = space_of(blocked, dear(rng, blocked))
    start, goal = random_free_point(rng, space), random_free_point(rng, space)
    plan = planner.plan(space, start, goal)
    regions, _ = label(~space.blocked)
    joined = regions[space.cell_of(start)] == regions[space.cell_of(goal)]
    if joined and not isinstance(planner, AStar) and plan.status == "gave up":
        assert_without_path(plan, "gave up")  # 5: a path through a maze takes more samples than the budget
        assert plan.expanded == SAMPLES
        return
    assert plan.status == ("found" if joined else "no path")
    if not joined:
        return
    path = plan.path_world
    assert len(path) >= 2 and (path[0] == start).all() and (path[-1] == goal).all()  # 1
    assert not touches_blocked(space, path) and path_is_free(space, path)  # 2
    length = np.hypot(*np.diff(path, axis=0).T).sum()
    assert plan.length_m == pytest.approx(length) and length - 1e-9 <= plan.cost <= 3.5 * length + 1e-9  # 3


def test_start_and_goal_may_lie_outside_the_known_grid(planner: Planner) -> None:
    space = space_from_text("""
        .......
        .#####.
        .#...#.
        .#.#.#.
        ...#...
        """)
    outside = [(3.0, 7.0), (-6.0, 2.32), (-0.97, -1.0), (-0.97, 2.35)]
    for start, goal in itertools.product(outside, outside):
        plan = planner.plan(space, start, goal)
        if not isinstance(planner, AStar) and plan.status == "gave up":
            assert outside[3] in (start, goal)  # behind a gap of one cell in thousands
            continue
        assert plan.found and (plan.path_world[[0, -1]] == [start, goal]).all()
        assert not touches_blocked(space, plan.path_world)
    empty = FreeSpace(np.zeros((0, 0), dtype=bool), np.zeros((0, 0), dtype=bool), (0.0, 0.0), CELL)
    assert planner.plan(empty, (5.0, 5.0), (7.0, 4.0)).found


def assert_without_path(plan: Plan, status: str) -> None:
    assert plan.status == status and not plan.found
    assert plan.path_world.shape == (0, 2) and plan.cost == math.inf


def test_a_place_that_is_walled_in_has_no_path_to_it_or_from_it(planner: Planner) -> None:
    space = space_from_text("""
        .......
        .#####.
        .#...#.
        .#####.
        """)
    outside, inside, wall = (space.centre(*cell) for cell in ((0, 0), (1, 3), (2, 3)))
    for start, goal in ((outside, inside), (inside, outside), (inside, (5.0, -5.0))):
        assert_without_path(planner.plan(space, start, goal), "no path")
    assert_without_path(planner.plan(space, (50.0, 50.0), wall), "goal blocked")


def test_a_start_that_is_the_goal_is_a_path_of_no_length(planner: Planner) -> None:
    space = space_from_text("""
        ..#
        #..
        """)
    for point in ((-1.0, 2.13), space.centre(0, 1), (90.0, -90.0)):
        plan = planner.plan(space, point, point)
        assert plan.found and plan.cost == 0.0 and np.array_equal(plan.path_world, [point, point])
    near = planner.plan(space, (-1.13, 2.11), (-1.19, 2.18))
    assert near.found and near.cost == pytest.approx(math.hypot(0.06, 0.07))


def test_a_start_on_the_edge_of_a_blocked_cell_gives_a_free_path(planner: Planner) -> None:
    blocked = np.zeros((8, 8), dtype=bool)
    blocked[:6, 3] = True
    space = FreeSpace(blocked, blocked, (0.0, 0.0), 0.25)
    plan = planner.plan(space, (1.0, 0.25), (0.5, 0.5))
    assert plan.found and path_is_free(space, plan.path_world)


@pytest.mark.parametrize("bad", [(1.0,), (1.0, 2.0, 3.0), (math.nan, 0.0), (0.0, -math.inf)])
def test_a_start_or_goal_that_is_no_point_is_refused_by_name(planner: Planner, bad: tuple[float, ...]) -> None:
    space = space_of(np.zeros((3, 3), dtype=bool))
    for named, ends in (("start", (bad, (0.0, 0.0))), ("goal", ((0.0, 0.0), bad))):
        with pytest.raises(ValueError, match=named):
            planner.plan(space, *ends)


# A*


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


# Short cuts


@pytest.mark.parametrize("seed", range(10))
@pytest.mark.parametrize("world", WORLDS)
def test_a_short_cut_keeps_the_ends_touches_nothing_and_costs_no_more(
    world: Callable[[np.random.Generator], Array], seed: int
) -> None:
    rng = np.random.default_rng(500 + seed)
    blocked = world(rng)
    space = space_of(blocked, dear(rng, blocked))
    plan = AStar().plan(space, random_free_point(rng, space), random_free_point(rng, space))
    short = shortcut(space, plan.path_world)
    if not plan.found:
        assert short.shape == (0, 2)
        return
    assert (short[[0, -1]] == plan.path_world[[0, -1]]).all()
    assert {tuple(p) for p in short} <= {tuple(p) for p in plan.path_world}
    assert space.path_cost(short) <= 1.001 * plan.cost + 1e-9
    assert path_is_free(space, short) and not touches_blocked(space, short)


def test_in_the_open_the_short_cut_is_the_straight_line() -> None:
    space = space_of(np.zeros((30, 30), dtype=bool))
    plan = AStar().plan(space, space.centre(2, 3), space.centre(25, 11))
    assert np.array_equal(shortcut(space, plan.path_world), plan.path_world[[0, -1]])


def test_a_short_cut_passes_a_narrow_gap_through_the_middle() -> None:
    blocked = np.ones((9, 21), dtype=bool)
    blocked[:, :8] = blocked[:, 13:] = blocked[4, :] = False
    offsets = np.zeros((9, 21, 2), dtype=np.float32)
    offsets[4, 8:13, 0] = 0.4
    space = FreeSpace(blocked, ~blocked, ORIGIN, CELL, offsets=offsets)
    plan = AStar().plan(space, space.centre(4, 1), space.centre(4, 19))
    short = shortcut(space, plan.path_world)
    assert 2 < len(short) < 8
    inside = short[np.abs(short[:, 0] - space.centre(4, 10)[0]) < 2.6 * CELL]
    assert inside[:, 1] == pytest.approx(space.centre(4, 0)[1] + 0.4 * CELL)


def test_a_new_obstacle_on_the_path_is_noticed_and_one_beside_it_is_not() -> None:
    blocked = np.zeros((9, 9), dtype=bool)
    path = np.array([space_of(blocked).centre(4, 0), space_of(blocked).centre(4, 8)])
    assert path_is_free(space_of(blocked), path)
    for row, col in np.ndindex(9, 9):
        hit = blocked.copy()
        hit[row, col] = True
        assert path_is_free(space_of(hit), path) == (row != 4)
    with pytest.raises(ValueError, match="path_world"):
        shortcut(space_of(blocked), path[0])
