"""Configuration of what drives the robot: exploration, planner, follower, and the guard that checks commands."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from sixthsense.config.section import NonNegative, Positive, Range, Section


@dataclass(frozen=True)
class ExploreConfig(Section):
    """Where to look next, and when all is seen (report section 4.5)."""

    method: Literal["frontier", "random"] = "frontier"
    """frontier: the first viewpoint of a short tour through all of them and home; random: places drawn in the largest
    unseen area (the report's idea)."""
    return_home: bool = True
    """Drive back to the start when all is seen."""
    margin_m: NonNegative = 1.0
    """How far outside the region the robot may drive, to get around a wall at its edge; up to the laser's range when
    the only unseen area left continues beyond the region."""
    loop_closure: bool = True
    """Drive back to a place where the pose was certain when it no longer is."""


@dataclass(frozen=True)
class RRTStarConfig(Section):
    """The sampling planner: RRT* (Karaman and Frazzoli 2011) and Informed RRT* (Gammell et al. 2014)."""

    informed: bool = True
    """Once there is a path, sample the ellipse that a shorter one must lie in (Informed RRT*)."""
    iterations: Annotated[int, Range(1, 10_000_000)] = 5_000
    """States drawn per plan; without a path by then the planner gives up."""


GOAL_SLACK_M = 0.05
"""a goal this near is reached: one cell of the map"""


@dataclass(frozen=True)
class FollowConfig(Section):
    """Orient, then translate (report section 4.4)."""

    heading_slack_rad: Positive = 0.02
    """The robot drives when its heading is this close to the waypoint's direction."""
    distance_slack_m: Annotated[float, Range(0.0, GOAL_SLACK_M, open_low=True)] = 0.02
    """A waypoint this near is reached."""


@dataclass(frozen=True)
class SafetyConfig(Section):
    """Paths keep a margin where there is room; the guard slows and stops the robot by its latest scan."""

    max_margin_m: Annotated[float, Range(0.0, 10.0)] = 0.3
    """Largest margin of a path beyond grid.clearance-m, however uncertain the pose; 0: no margin."""
    guard: bool = True
    """Off: commands are not checked."""
