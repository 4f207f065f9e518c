"""A* over the cells of a free space (report section 4.4), optimal among 8-connected paths that cut no corner."""

from __future__ import annotations

import time

import numpy as np
from numpy.typing import ArrayLike

from sixthsense.navigation.gridsearch import CostTree
from sixthsense.navigation.planners.base import Plan, joined_path, plan_with_blocked_end
from sixthsense.slam.mapping.freespace import FreeSpace, as_point


class AStar:
    """Shortest path from cell centre to cell centre, joined to the exact start and goal.

    While goal and grid stay the same, a plan reuses the search tree of the last one, so that the cost of a replan grows
    with the changes of the map. Its path is as short as that of a search from scratch, but may be another of equal
    length.
    """

    def __init__(self, rng: np.random.Generator | None = None) -> None:
        """Begin without a search tree; it draws nothing from `rng`."""
        self._tree: CostTree | None = None
        self._place: tuple[tuple[float, float], float] | None = None

    def plan(self, space: FreeSpace, start: ArrayLike, goal: ArrayLike) -> Plan:
        """Plan by the contract of `Planner`; the path is start, the centres of all its cells, goal."""
        began = time.perf_counter()
        start_world, goal_world = as_point("start", start), as_point("goal", goal)
        space = space.covering(start_world, goal_world)
        no_path = plan_with_blocked_end(space, start_world, goal_world, began)
        if no_path is not None:
            return no_path
        tree = self._tree_to(space, space.cell_of(goal_world))
        cost, expanded = tree.reach(space.cell_of(start_world))
        if cost == np.inf:
            return Plan.without_path("no path", expanded, time.perf_counter() - began)
        cells = tree.path(space.cell_of(start_world))
        centres = np.array(space.origin) + (cells[:, ::-1] + 0.5) * space.cell_m
        # Within one cell the straight line is free.
        between = centres if len(cells) > 1 else np.empty((0, 2))
        path_world = joined_path(start_world, between, goal_world)  # an end may be a centre
        return Plan.along(path_world, expanded, time.perf_counter() - began)

    def _tree_to(self, space: FreeSpace, goal: tuple[int, int]) -> CostTree:
        """The tree of the last plan, updated, or a new one."""
        tree, place = self._tree, (space.origin, space.cell_m)
        same = tree is not None and (tree.goal, self._place, tree.blocked.shape) == (goal, place, space.blocked.shape)
        if tree is not None and same:
            tree.update(space.blocked)
            return tree
        self._tree = None  # free the memory before the next allocation
        self._tree, self._place = CostTree(space.blocked, goal), place
        return self._tree
