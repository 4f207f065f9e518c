"""RRT* (Karaman and Frazzoli, IJRR 30(7), 2011) and Informed RRT* (Gammell et al., IROS 2014), through OMPL.

States are drawn from the box about what can be reached, not about the whole map: rooms are walled in.
"""

from __future__ import annotations

import time

import numba
import numpy as np
from numpy.typing import ArrayLike, NDArray
from ompl import base, geometric, util

from sixthsense.config import RRTStarConfig
from sixthsense.core.geometry import Array
from sixthsense.navigation.planners.base import Plan, blocked_end, joined_path
from sixthsense.slam.mapping.freespace import TOUCH, Bools, FreeSpace, as_point, line_touches


class RRTStar:
    """A short path through any points, not cells alone, as good as a budget of iterations makes it.

    The budget is counted, not timed, and every plan draws from the same seed: the same question has the same answer.
    """

    def __init__(self, config: RRTStarConfig, rng: np.random.Generator) -> None:
        """Draw the seed from `rng`; it takes no more from it, however often it plans."""
        self._config = config
        self._seed = int(rng.integers(1, 1 << 32))

    def plan(self, space: FreeSpace, start: ArrayLike, goal: ArrayLike) -> Plan:
        """Plan as `Planner` promises; "gave up" when the iterations ended without a path, though there is one."""
        began = time.perf_counter()
        start_world, goal_world = as_point("start", start), as_point("goal", goal)
        space = space.covering(start_world, goal_world)
        none = blocked_end(space, start_world, goal_world, began)
        if none is not None:
            return none
        first, last = _inside(space, start_world), _inside(space, goal_world)
        drawn = 0
        # No path is shorter than a straight one.
        if space.line_is_free(start_world, goal_world):
            between: Array | None = np.empty((0, 2))
        elif space.line_is_free(first, last):
            between = np.array([first, last])
        else:
            cells = reachable(space.blocked, *space.cell_of(start_world))
            row, col = space.cell_of(goal_world)
            if row * space.blocked.shape[1] + col not in cells:
                return Plan.without_path("no path", 0, time.perf_counter() - began)
            between, drawn = self._solve(space, cells, first, last)
        if between is None:
            return Plan.without_path("gave up", drawn, time.perf_counter() - began)
        path_world = joined_path(start_world, between, goal_world)
        return Plan.along(path_world, drawn, time.perf_counter() - began)

    def _solve(self, space: FreeSpace, cells: NDArray[np.int32], first: Array, last: Array) -> tuple[Array | None, int]:
        """The way points (N, 2) from `first` to `last`, None if there was no path by then, and the iterations."""
        util.setLogLevel(util.LogLevel.LOG_NONE)
        # Seeds whatever is made from here on, so all of it is made anew.
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
        planner.setRange(config.range_m)
        planner.setGoalBias(config.goal_bias)
        planner.setProblemDefinition(problem)
        planner.setup()
        left = iter(range(config.iterations))
        planner.solve(base.PlannerTerminationCondition(lambda: next(left, None) is None))
        drawn = int(planner.numIterations())
        if not problem.hasExactSolution():
            return None, drawn
        return np.array([[state[0], state[1]] for state in problem.getSolutionPath().getStates()]), drawn


class _FreeMotions(base.MotionValidator):  # type: ignore[misc]
    """Whether the segment between two states is free, by the very arithmetic of `FreeSpace.line_is_free`."""

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


def _inside(space: FreeSpace, point_world: Array) -> Array:
    """The point, or, where it lies on an edge that a blocked cell shares, so that no way out is free, its centre."""
    row, col = space.cell_of(point_world)
    in_cells = (point_world - space.origin) / space.cell_m
    if (np.abs(in_cells - np.round(in_cells)) > 2.0 * TOUCH).all():
        return point_world
    beside = space.blocked[max(row - 1, 0) : row + 2, max(col - 1, 0) : col + 2]
    return space.centre(row, col) if beside.any() else point_world


@numba.njit(cache=True, error_model="numpy")
def reachable(blocked: Bools, row: int, col: int) -> NDArray[np.int32]:
    """The flat indices (K,) of the cells of (H, W) `blocked` that straight steps lead to from a free one, that first.

    Who may not cut corners gets no farther by diagonal steps.
    """
    height, width = blocked.shape
    seen = blocked.copy().ravel()
    cells = np.empty(np.count_nonzero(~seen), dtype=np.int32)
    cells[0] = row * width + col
    seen[cells[0]] = True
    count, i = 1, 0
    while i < count:
        cell = cells[i]
        across = cell % width
        for to, inside in (
            (cell - width, cell >= width),
            (cell + width, cell < width * (height - 1)),
            (cell - 1, across > 0),
            (cell + 1, across < width - 1),
        ):
            if inside and not seen[to]:
                seen[to] = True
                cells[count] = to
                count += 1
        i += 1
    return cells[:count].copy()
