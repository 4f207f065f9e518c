"""The laws of the contracts of `Planner` and `Explorer`."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from sixthsense.config import preset
from sixthsense.config.parts import EXPLORERS
from sixthsense.config.tree import make_part
from sixthsense.core.geometry import Array, Pose
from sixthsense.core.laser import Scan, beam_bearings
from sixthsense.core.ray_casting import cast_rays
from sixthsense.navigation.exploration import Exploration
from sixthsense.navigation.explorer import ExplorationView, Explorer, Target, target_fault
from sixthsense.navigation.path_planner import DrivingMap
from sixthsense.navigation.planners import Plan, Planner, make_planner
from sixthsense.navigation.planners.astar import AStar
from sixthsense.navigation.planners.base import plan_fault
from sixthsense.slam.estimators import Estimate
from sixthsense.slam.mapping.freespace import FreeSpace
from sixthsense.slam.mapping.grid import Grid
from sixthsense.testing.laws import Laws, agree, at_most, equal, refuse

PLANNER_LAWS, EXPLORER_LAWS = Laws(), Laws()

_CELL_M, _ORIGIN = 0.1, (-1.35, 0.25)
_RADIUS_M, _ROOMS, _MOST_CHOICES = 0.17, (0.1, 0.2, 7.3, 3.4), 200
_BETWEEN = np.array([[[3.9, 0.2], [3.9, 1.7]], [[3.9, 2.8], [3.9, 3.4]]])
"""the wall between two rooms, with a door of 1.1 m"""


def _space(seed: int, share: float = 0.25) -> tuple[FreeSpace, np.random.Generator]:
    """A seen space of 40 x 52 cells with some blocks in it."""
    rng = np.random.default_rng(seed)
    blocked = np.zeros((40, 52), dtype=np.bool_)
    while blocked.mean() < share:
        row, col = rng.integers(0, 36), rng.integers(0, 48)
        blocked[row : row + rng.integers(1, 5), col : col + rng.integers(1, 5)] = True
    cost = np.where(blocked, np.inf, rng.choice([1.0, 1.0, 2.5], blocked.shape)).astype(np.float32)
    return FreeSpace(blocked, np.ones_like(blocked), _ORIGIN, _CELL_M, cost), rng


def _free(space: FreeSpace, rng: np.random.Generator) -> Array:
    """A random point in a free cell."""
    row, col = rng.permutation(np.argwhere(~space.blocked))[0]
    return space.centre(int(row), int(col)) + rng.uniform(-0.04, 0.04, 2)


def _questions() -> Iterator[tuple[FreeSpace, Array, Array]]:
    for seed in range(6):
        space, rng = _space(seed, 0.05 + 0.06 * seed)
        for _ in range(2):
            yield space, _free(space, rng), _free(space, rng)


@PLANNER_LAWS.law()
def a_path_joins_start_and_goal_through_free_cells_at_the_cost_it_says(part: Any) -> None:
    planner: Planner = make_planner(part)
    for space, start, goal in _questions():
        plan = planner.plan(space, start, goal)
        refuse(plan_fault(plan, space, start, goal))
        if plan.found:
            agree("cost", plan.cost, space.path_cost(plan.path_world), atol=1e-9)
            assert not plan.path_world.flags.writeable, "found a path that may be written to, allowed: a read-only one"


@PLANNER_LAWS.law()
def a_path_is_found_only_where_there_is_one_and_no_shorter_than_any(part: Any) -> None:
    planner, astar = make_planner(part), AStar()
    for space, start, goal in _questions():
        plan, shortest = planner.plan(space, start, goal), astar.plan(space, start, goal)
        assert shortest.found or not plan.found, "found a path where there is none"
        assert not plan.found or plan.length_m >= math.dist(start, goal) - 1e-9
        assert plan.status != "no path" or not shortest.found, "found no path where there is one, allowed: gave up"


@PLANNER_LAWS.law()
def what_stands_in_the_way_is_named_start_first(part: Any) -> None:
    space, rng = _space(3)
    inside = space.centre(*np.argwhere(space.blocked)[7].tolist())
    free, planner = _free(space, rng), make_planner(part)
    for start, goal, allowed in ((free, inside, "goal blocked"), (inside, inside, "start blocked")):
        plan = planner.plan(space, start, goal)
        equal("status", plan.status, allowed)
        equal("path and cost", (plan.path_world.shape, plan.cost), ((0, 2), math.inf))


@PLANNER_LAWS.law()
def the_same_question_has_the_same_answer(part: Any) -> None:
    one, other = make_planner(part), make_planner(part)
    for space, start, goal in _questions():
        plans: list[Plan] = [planner.plan(space, start, goal) for planner in (one, other, one)]
        equal("statuses", {plan.status for plan in plans}, {plans[0].status})
        agree("path", plans[1].path_world, plans[0].path_world)
        at_most("cost of the second answer", plans[2].cost, plans[0].cost + 1e-9)


class _Watched:
    """An explorer whose targets are kept, with what is wrong with them."""

    def __init__(self, explorer: Explorer) -> None:
        self._explorer = explorer
        self.targets: list[Target | None] = []
        self.faults: list[str] = []

    def next_target(self, view: ExplorationView) -> Target | None:
        masks = view.free, view.unseen, view.reachable
        before = [mask.copy() for mask in masks]
        target = self._explorer.next_target(view)
        fault = target_fault(view, target)
        if not all(map(np.array_equal, before, masks)):
            fault = "found masks of the view that were written to"
        self.targets.append(target)
        self.faults += [fault] * bool(fault)
        return None if fault else target


def _explored(part: Any) -> tuple[_Watched, bool]:
    """An explorer after a robot has explored two rooms, jumping from view to view; and whether it ended."""
    config, pose = preset(), Pose(1.1, 0.9, 0.3)
    x0, y0, x1, y1 = _ROOMS
    corners = np.array([(x0, y0), (x1, y0), (x1, y1), (x0, y1)])
    walls = np.concatenate([np.stack([corners, np.roll(corners, -1, axis=0)], axis=1), _BETWEEN])
    grid = Grid(config.grid, _RADIUS_M)

    exploration = Exploration(pose.position, _ROOMS, _RADIUS_M, config, np.random.default_rng(4))
    watched, map_ = _Watched(make_part(EXPLORERS, part, np.random.default_rng(7))), DrivingMap(_RADIUS_M, config, True)
    exploration.explorer = watched
    for _ in range(_MOST_CHOICES):
        ranges = cast_rays(pose, beam_bearings(config.laser), walls, config.laser.max_range)
        grid.add(pose, Scan.from_config(ranges, config.laser))
        map_.update(grid, Estimate.of_pose(pose, np.zeros((3, 3))))
        chosen = len(watched.targets)
        goal = exploration.next(map_, pose, "looked")
        if goal is not None and len(watched.targets) == chosen:
            goal = exploration.next(map_, pose, "arrived")  # at a target that cannot be seen from there
        if goal is None or exploration.state != "viewing":
            return watched, True
        pose = Pose.from_array(np.append(goal.position, 0.3))
    return watched, False


@EXPLORER_LAWS.law()
def every_target_is_of_unseen_cells_and_seen_from_where_the_robot_can_drive(part: Any) -> None:
    refuse("".join(_explored(part)[0].faults[:1]))


@EXPLORER_LAWS.law()
def the_other_room_is_looked_at_and_the_exploration_ends(part: Any) -> None:
    watched, has_ended = _explored(part)
    assert any(watched.targets), "found no target, allowed: some"
    assert has_ended, f"found {len(watched.targets)} targets and no end, allowed: None when nothing is left"


@EXPLORER_LAWS.law()
def the_same_map_and_generator_give_the_same_targets(part: Any) -> None:
    one, other = (_explored(part)[0].targets for _ in range(2))
    equal("targets and ends", [target is None for target in one], [target is None for target in other])
    for first, second in zip(one, other, strict=True):
        if first is not None and second is not None:
            agree("cells", first.cells, second.cells)
            agree("viewpoint", first.viewpoint, second.viewpoint)
