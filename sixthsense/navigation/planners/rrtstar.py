"""RRT* (Karaman and Frazzoli, IJRR 30(7), 2011) and Informed RRT* (Gammell et al., IROS 2014), through OMPL.

States are sampled from the bounding box of the reachable cells, not of the whole map.
"""

from __future__ import annotations

import time

import numpy as np
from numpy.typing import ArrayLike, NDArray
from ompl import base, geometric, util
from scipy import ndimage

from sixthsense.config import RRTStarConfig
from sixthsense.core.geometry import Array
from sixthsense.navigation.planners.base import Plan, joined_path, plan_with_blocked_end
from sixthsense.slam.mapping.freespace import TOUCH, FreeSpace, as_point, line_touches

_RANGE_M = 2.0  # longest extension of the tree per draw: about a room's half


class RRTStar:
    """A short path through arbitrary points, improved for a given number of iterations.

    Iterations are counted, not timed, and every plan uses the same seed, so that the same question has the same answer.
    """

    Options = RRTStarConfig

    def __init__(self, rng: np.random.Generator, config: RRTStarConfig) -> None:
        """Draw the seed from `rng`, once for all plans."""
        self._config = config
        self._seed = int(rng.integers(1, 1 << 32))

    def plan(self, space: FreeSpace, start: ArrayLike, goal: ArrayLike) -> Plan:
        """Plan by the contract of `Planner`; "gave up": the iterations ended without a path, though there is one."""
        began = time.perf_counter()
        start_world, goal_world = as_point("start", start), as_point("goal", goal)
        space = space.covering(start_world, goal_world)
        no_path = plan_with_blocked_end(space, start_world, goal_world, began)
        if no_path is not None:
            return no_path
        first, last = _point_with_free_exit(space, start_world), _point_with_free_exit(space, goal_world)
        iterations = 0
        # A straight line is the shortest path.
        if space.line_is_free(start_world, goal_world):
            between: Array | None = np.empty((0, 2))
        elif space.line_is_free(first, last):
            between = np.array([first, last])
        else:
            parts, _ = ndimage.label(~space.blocked)
            cells = np.flatnonzero(parts == parts[space.cell_of(start_world)])
            if parts[space.cell_of(goal_world)] != parts[space.cell_of(start_world)]:
                return Plan.without_path("no path", 0, time.perf_counter() - began)
            between, iterations = self._solve(space, cells, first, last)
        if between is None:
            return Plan.without_path("gave up", iterations, time.perf_counter() - began)
        path_world = joined_path(start_world, between, goal_world)
        return Plan.along(space, path_world, iterations, time.perf_counter() - began)

    def _solve(self, space: FreeSpace, cells: NDArray[np.int64], first: Array, last: Array) -> tuple[Array | None, int]:
        """The way points (N, 2) from `first` to `last`, None if no path was found, and the number of iterations."""
        util.setLogLevel(util.LogLevel.LOG_NONE)
        # The seed applies to the objects made from here on.
        util.RNG.setSeed(self._seed)
        plane = base.RealVectorStateSpace(2)
        bounds = base.RealVectorBounds(2)
        for axis, numbers in enumerate((cells % space.blocked.shape[1], cells // space.blocked.shape[1])):
            bounds.setLow(axis, space.origin[axis] + float(numbers.min()) * space.cell_m)
            bounds.setHigh(axis, space.origin[axis] + float(numbers.max() + 1) * space.cell_m)
        plane.setBounds(bounds)
        information = base.SpaceInformation(plane)
        information.setStateValidityChecker(lambda state: not space.is_blocked((state[0], state[1])))
        motions = _FreeMotions(information, space)
        information.setMotionValidator(motions)
        information.setup()
        problem = base.ProblemDefinition(information)
        ends = []
        for point in (first, last):
            state = plane.allocState()
            state[0], state[1] = float(point[0]), float(point[1])
            ends.append(state)
        problem.setStartAndGoalStates(*ends)
        problem.setOptimizationObjective(base.PathLengthOptimizationObjective(information))
        config = self._config
        planner = (geometric.InformedRRTstar if config.informed else geometric.RRTstar)(information)
        planner.setRange(_RANGE_M)
        planner.setProblemDefinition(problem)
        planner.setup()
        left = iter(range(config.iterations))
        planner.solve(base.PlannerTerminationCondition(lambda: next(left, None) is None))
        iterations = int(planner.numIterations())
        if not problem.hasExactSolution():
            return None, iterations
        return np.array([[state[0], state[1]] for state in problem.getSolutionPath().getStates()]), iterations


class _FreeMotions(base.MotionValidator):  # type: ignore[misc]
    """Whether the segment between two states is free, by the same arithmetic as `FreeSpace.line_is_free`."""

    def __init__(self, information: base.SpaceInformation, space: FreeSpace) -> None:
        super().__init__(information)
        self._blocked = space.blocked
        self._x, self._y = space.origin
        self._cell_m = space.cell_m

    def checkMotion(self, a: base.State, b: base.State) -> bool:  # noqa: N802
        x, y, cell_m = self._x, self._y, self._cell_m
        return not line_touches(
            self._blocked, (a[0] - x) / cell_m, (a[1] - y) / cell_m, (b[0] - x) / cell_m, (b[1] - y) / cell_m
        )


def _point_with_free_exit(space: FreeSpace, point_world: Array) -> Array:
    """The point, or the centre of its cell if it lies on an edge of a blocked cell, from where no segment is free."""
    row, col = space.cell_of(point_world)
    in_cells = (point_world - space.origin) / space.cell_m
    if (np.abs(in_cells - np.round(in_cells)) > 2.0 * TOUCH).all():
        return point_world
    beside = space.blocked[max(row - 1, 0) : row + 2, max(col - 1, 0) : col + 2]
    return space.centre(row, col) if beside.any() else point_world
