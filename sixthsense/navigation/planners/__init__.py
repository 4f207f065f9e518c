"""Path planners behind one protocol."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from sixthsense.config import RRTStarConfig
from sixthsense.config.errors import InputError, nearest
from sixthsense.config.names import PLANNERS as NAMES
from sixthsense.navigation.planners.base import Plan, Planner

__all__ = ["PLANNERS", "Plan", "Planner", "PlannerFactory", "make_planner", "register_planner"]

PLANNERS = NAMES.shipped

PlannerFactory = Callable[[np.random.Generator], Planner]

_REGISTERED: dict[str, PlannerFactory] = {}


def register_planner(name: str, factory: PlannerFactory) -> None:
    """Allow `name` as the configuration's field `planner` in this process; `factory` makes the planner.

    `factory` is called with the run's random generator for planning. Registering a name again replaces its factory.
    Raises ValueError for the name of a built-in planner and for an invalid name.
    """
    NAMES.add(name)
    _REGISTERED[name] = factory


def make_planner(name: str, rrtstar: RRTStarConfig | None = None, rng: np.random.Generator | None = None) -> Planner:
    """The planner of that name; ValueError listing the known names for any other.

    `rrtstar` configures the planner of that name. `rng`, with seed 0 by default, is for it and for registered planners.
    """
    if name in _REGISTERED:
        return _REGISTERED[name](rng or np.random.default_rng(0))
    if name == "astar":
        from sixthsense.navigation.planners.astar import AStar

        return AStar()
    if name == "rrtstar":
        from sixthsense.navigation.planners.rrtstar import RRTStar

        return RRTStar(rrtstar or RRTStarConfig(), rng or np.random.default_rng(0))
    raise InputError("planner", f"found {name!r}", ", ".join(NAMES), nearest(name, NAMES))
