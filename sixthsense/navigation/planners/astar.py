"""A* over the cells of a free space (report section 4.4), optimal among 8-connected paths that cut no corner."""

from __future__ import annotations

import time

import numpy as np
from numpy.typing import ArrayLike

from sixthsense.navigation.gridsearch import cheapest_path
from sixthsense.navigation.planners.base import Plan, joined_path, plan_with_blocked_end
from sixthsense.slam.mapping.freespace import FreeSpace, as_point


class AStar:
    """Cheapest path from cell to cell, by their centres, or the middle of narrow gaps, joined to start and goal."""

    def __init__(self, rng: np.random.Generator | None = None) -> None:
        """It draws nothing from `rng`."""

    def plan(self, space: FreeSpace, start: ArrayLike, goal: ArrayLike) -> Plan:
        """Plan by the contract of `Planner`; the path is start, a place in each of its cells, goal."""
        began = time.perf_counter()
        start_world, goal_world = as_point("start", start), as_point("goal", goal)
        space = space.covering(start_world, goal_world)
        no_path = plan_with_blocked_end(space, start_world, goal_world, began)
        if no_path is not None:
            return no_path
        cells, _, expanded = cheapest_path(space.cost, space.cell_of(start_world), space.cell_of(goal_world))
        if len(cells) == 0:
            return Plan.without_path("no path", expanded, time.perf_counter() - began)
        places = cells + 0.5 + space.offsets[tuple(cells.T)]
        # Within one cell the straight line is free.
        between = np.array(space.origin) + places[:, ::-1] * space.cell_m if len(cells) > 1 else np.empty((0, 2))
        path_world = joined_path(start_world, between, goal_world)  # an end may be a centre
        return Plan.along(space, path_world, expanded, time.perf_counter() - began)
