import math
from itertools import pairwise
from unittest.mock import patch

import numpy as np
import pytest
from test_planners import CELL, WORLDS, assert_without_path, random_free_point, space_from_text, space_of

from sixthsense.config import RRTStarConfig, preset
from sixthsense.core.geometry import Array
from sixthsense.loop.run import run
from sixthsense.navigation.planners import make_planner, rrtstar
from sixthsense.navigation.planners.base import Plan
from sixthsense.navigation.planners.rrtstar import RRTStar, _FreeMotions, _point_with_free_exit
from sixthsense.slam.mapping.freespace import FreeSpace

BOTH = pytest.mark.parametrize("informed", [True, False])


def box() -> FreeSpace:
    """A box of 2 m x 1 m in a room of 4 m x 4 m."""
    blocked = np.zeros((40, 40), dtype=bool)
    blocked[10:30, 15:25] = True
    return space_of(blocked)


def plan_of(space: FreeSpace, start: Array, goal: Array, seed: int = 0, range_m: float = 2.0, **config: object) -> Plan:
    with patch.object(rrtstar, "_RANGE_M", range_m):
        return make_planner("rrtstar", np.random.default_rng(seed), RRTStarConfig(**config)).plan(space, start, goal)


@BOTH
def test_a_budget_that_ends_without_a_path_is_named_as_such(informed: bool) -> None:
    space = box()
    plan = plan_of(space, space.centre(20, 5), space.centre(20, 34), informed=informed, iterations=2)
    assert_without_path(plan, "gave up")
    assert plan.expanded == 2


@BOTH
@pytest.mark.parametrize("seed", range(3))
def test_among_blocks_there_is_a_path_where_a_star_finds_one(informed: bool, seed: int) -> None:
    rng = np.random.default_rng(seed)
    space = space_of(WORLDS[1](rng))
    start, goal = random_free_point(rng, space), random_free_point(rng, space)
    plan = plan_of(space, start, goal, informed=informed, iterations=4000, range_m=0.5)
    cells = make_planner("astar").plan(space, start, goal)
    assert plan.status == cells.status
    assert plan.cost <= 1.03 * cells.cost


def test_informed_samples_find_shorter_paths_than_uniform_ones_on_the_same_budget() -> None:
    space = box()
    start, goal = space.centre(20, 5), space.centre(20, 34)
    costs = np.array(
        [
            [plan_of(space, start, goal, seed, informed=informed, iterations=1500).cost for informed in (True, False)]
            for seed in range(12)
        ]
    )
    assert costs.max() < math.inf
    assert np.median(costs[:, 0]) < np.median(costs[:, 1])


def test_a_sample_extends_the_tree_by_no_more_than_the_range() -> None:
    space = box()
    start, goal = space.centre(20, 5), space.centre(20, 34)
    # A tree that grows by one cell per sample does not get around the box within the budget.
    assert any(plan_of(space, start, goal, seed, iterations=60).found for seed in range(20))
    assert plan_of(space, start, goal, iterations=20, range_m=CELL).status == "gave up"


def test_a_motion_is_free_when_its_line_is() -> None:
    from ompl import base

    rng = np.random.default_rng(2)
    space = space_of(WORLDS[0](rng))
    plane = base.RealVectorStateSpace(2)
    information = base.SpaceInformation(plane)
    motions = _FreeMotions(information, space)
    a, b = plane.allocState(), plane.allocState()
    answers = []
    for ends in rng.uniform(-0.5, 3.0, (300, 2, 2)) + space.origin:
        (a[0], a[1]), (b[0], b[1]) = ends.tolist()
        answers.append(motions.checkMotion(a, b))
        assert answers[-1] == space.line_is_free(*ends)
    assert 10 < sum(answers) < 290


def test_an_end_on_the_edge_of_a_blocked_cell_is_left_by_way_of_its_centre() -> None:
    space = space_from_text("""
        .....
        .#...
        .....
        """)
    corner = np.array(space.origin) + CELL
    edge = corner + np.array([CELL, 0.5 * CELL])  # of the blocked cell, on its right
    assert np.array_equal(_point_with_free_exit(space, edge), space.centre(1, 2))
    far = corner + np.array([3 * CELL, 0.5 * CELL])
    assert np.array_equal(_point_with_free_exit(space, far), far)
    inner = space.centre(1, 2)
    assert np.array_equal(_point_with_free_exit(space, inner), inner)
    plan = plan_of(space, edge, space.centre(1, 0), iterations=2000, range_m=CELL)
    assert plan.found and all(space.line_is_free(p, q) for p, q in pairwise(plan.path_world))
    assert (plan.path_world[0] == edge).all()


def test_a_planner_draws_one_seed_from_its_stream_however_often_it_plans() -> None:
    rng, beside = np.random.default_rng(3), np.random.default_rng(3)
    planner = RRTStar(rng, RRTStarConfig(iterations=100))
    beside.integers(1, 1 << 32)
    planner.plan(box(), box().centre(20, 5), box().centre(20, 34))
    assert rng.random() == beside.random()


def test_a_robot_that_draws_its_plans_reaches_its_goal_and_the_same_seed_drives_the_same_way() -> None:
    config = preset(scene="rectangle", planner="rrtstar", task="goal", max_time=60.0, rrtstar={"iterations": 500})
    first, again = run(config), run(config)
    assert first.outcome == again.outcome == "goal reached"
    assert np.array_equal(first.truths, again.truths)
    assert len(first.plans) == len(again.plans)
    assert all(np.array_equal(a, b) for a, b in zip(first.plans, again.plans, strict=True))
