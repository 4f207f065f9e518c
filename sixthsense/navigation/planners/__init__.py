"""Path planners behind one protocol."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from sixthsense.config.parts import PLANNERS as PARTS
from sixthsense.config.tree import make_part
from sixthsense.navigation.planners.base import Plan, Planner

__all__ = ["PLANNERS", "Plan", "Planner", "PlannerFactory", "make_planner"]

PLANNERS = tuple(PARTS)
"""names of the shipped ones"""

PlannerFactory = Callable[..., Planner]
"""A planner's class, or a function that makes one: of the run's random generator for planning, and of an object of its
`Options`, if it has any."""


def make_planner(planner: str | PlannerFactory, rng: np.random.Generator | None = None, options: Any = None) -> Planner:
    """Make a planner, by its name or its class; InputError listing the known names for any other.

    `rng` is by default one with seed 0; `options` are an object of the planner's `Options`, by default one without
    arguments.
    """
    made: Planner = make_part(PARTS, planner, rng or np.random.default_rng(0), options=options)
    return made
