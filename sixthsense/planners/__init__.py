"""Path planners behind one protocol."""

from __future__ import annotations

from sixthsense.planners.base import Plan, Planner

PLANNERS = ("astar",)

__all__ = ["PLANNERS", "Plan", "Planner", "make_planner"]


def make_planner(name: str) -> Planner:
    """The planner of that name; ValueError listing the known names for any other."""
    if name == "astar":
        from sixthsense.planners.astar import AStar

        return AStar()
    raise ValueError(f"planner: found {name!r}, allowed: {', '.join(PLANNERS)}")
