"""A planner of your own: the straight line to the goal, or none."""

import numpy as np

from sixthsense import Plan


class StraightLine:
    """Plans the straight line, where it is free."""

    def __init__(self, rng):
        pass

    def plan(self, space, start, goal):
        start, goal = (np.asarray(point, dtype=float) for point in (start, goal))
        for name, point in (("start", start), ("goal", goal)):
            if point.shape != (2,) or not np.isfinite(point).all():
                raise ValueError(f"{name}: found {point}, allowed: (2,) finite numbers")
        for name, point in (("start", start), ("goal", goal)):
            if space.is_blocked(point):
                return Plan.without_path(f"{name} blocked", expanded=0, seconds=0.0)
        if not space.line_is_free(start, goal):
            return Plan.without_path("gave up", expanded=0, seconds=0.0)
        return Plan.along(space, [start, goal], expanded=0, seconds=0.0)
