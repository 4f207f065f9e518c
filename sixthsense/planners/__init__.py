"""Path planners behind one protocol."""

from __future__ import annotations

import numpy as np

from sixthsense.config import RRTStarConfig
from sixthsense.planners.base import Plan, Planner

PLANNERS = ("astar", "rrtstar")

__all__ = ["PLANNERS", "Plan", "Planner", "make_planner"]


def make_planner(name: str, rrtstar: RRTStarConfig | None = None, rng: np.random.Generator | None = None) -> Planner:
    """The planner of that name; ValueError listing the known names for any other.

    `rrtstar` is for the planner of that name, as is `rng`, of seed 0 if there is none.
    """
    if name == "astar":
        from sixthsense.planners.astar import AStar

        return AStar()
    if name == "rrtstar":
        from sixthsense.planners.rrtstar import RRTStar

        return RRTStar(rrtstar or RRTStarConfig(), rng or np.random.default_rng(0))
    raise ValueError(f"planner: found {name!r}, allowed: {', '.join(PLANNERS)}")
