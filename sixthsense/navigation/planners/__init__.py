"""Path planners behind one protocol."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from sixthsense.config import RRTStarConfig
from sixthsense.config.names import PLANNERS as NAMES
from sixthsense.navigation.planners.base import Plan, Planner

__all__ = ["PLANNERS", "Plan", "Planner", "PlannerFactory", "make_planner", "register_planner"]

PLANNERS = NAMES.shipped

PlannerFactory = Callable[[np.random.Generator], Planner]

_OWN: dict[str, PlannerFactory] = {}


def register_planner(name: str, factory: PlannerFactory) -> None:
    """Let the configuration's field `planner` be `name`, in this process, and make it by `factory`.

    `factory` is called with the run's generator of random numbers for planning. A name of one's own may be registered
    again, and then is the newer one's. ValueError for a name that ships, or that is no name.
    """
    NAMES.add(name)
    _OWN[name] = factory


def make_planner(name: str, rrtstar: RRTStarConfig | None = None, rng: np.random.Generator | None = None) -> Planner:
    """The planner of that name; ValueError listing the known names for any other.

    `rrtstar` is for the planner of that name; `rng`, of seed 0 if there is none, for it and for registered ones.
    """
    if name in _OWN:
        return _OWN[name](rng or np.random.default_rng(0))
    if name == "astar":
        from sixthsense.navigation.planners.astar import AStar

        return AStar()
    if name == "rrtstar":
        from sixthsense.navigation.planners.rrtstar import RRTStar

        return RRTStar(rrtstar or RRTStarConfig(), rng or np.random.default_rng(0))
    raise ValueError(f"planner: found {name!r}, allowed: {NAMES}")
