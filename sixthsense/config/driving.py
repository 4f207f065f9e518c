"""Configuration of what drives the robot: exploration, planner, follower, and the guard that checks commands."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from sixthsense.config.errors import InputError
from sixthsense.config.section import NonNegative, Positive, PositiveCount, Range, Section


@dataclass(frozen=True)
class ExploreConfig(Section):
    """Where to look next, and when all is seen (report section 4.5)."""

    method: Literal["frontier", "random"] = "frontier"
    """frontier: the first viewpoint of a short tour through all of them and home; random: places drawn in the largest
    unseen area (the report's idea)."""
    return_home: bool = True
    """Drive back to the start when all is seen."""
    tries: PositiveCount = 2
    """A target that was not seen from this many viewpoints, with a full turn at each, is given up."""
    dust: Annotated[float, Range(0.0, 1.0)] = 0.001
    """Small unseen areas are ignored, the smallest first, up to this share of the area seen."""
    margin_m: NonNegative = 1.0
    """How far outside the region the robot may drive, to get around a wall at its edge; up to the laser's range when
    the only unseen area left continues beyond the region."""
    least_area_m2: NonNegative = 0.02
    """An area that was given up counts as left unseen if it is at least this large."""
    loop_closure: bool = True
    """Drive back to a place where the pose was certain when it no longer is."""
    loop_closure_sigma_m: Positive = 0.1
    """The pose is uncertain when the largest sigma of its position is above this."""


@dataclass(frozen=True)
class RRTStarConfig(Section):
    """The sampling planner: RRT* (Karaman and Frazzoli 2011) and Informed RRT* (Gammell et al. 2014)."""

    informed: bool = True
    """Once there is a path, sample the ellipse that a shorter one must lie in (Informed RRT*)."""
    iterations: Annotated[int, Range(1, 10_000_000)] = 5_000
    """States drawn per plan; without a path by then the planner gives up."""
    range_m: NonNegative = 2.0
    """Longest extension of the tree per draw; 0: a fifth of the diagonal of the reachable area."""
    goal_bias: Annotated[float, Range(0.0, 1.0, open_low=True)] = 0.05
    """Share of draws, before there is a path, that are the goal itself."""


@dataclass(frozen=True)
class FollowConfig(Section):
    """Orient, then translate (report section 4.4)."""

    heading_slack_rad: Positive = 0.02
    """The robot drives when its heading is this close to the waypoint's direction."""
    distance_slack_m: Positive = 0.02
    """A waypoint this near is reached."""
    goal_slack_m: Positive = 0.05
    """A goal this near is reached."""
    shortcut: bool = True
    """Aim for the furthest waypoint in line of sight, not for the next."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.distance_slack_m > self.goal_slack_m:
            found = f"found {self.distance_slack_m:g}"
            raise InputError("distance_slack_m", found, f"at most goal_slack_m, {self.goal_slack_m:g}")


@dataclass(frozen=True)
class SafetyConfig(Section):
    """Paths keep a margin where there is room; the guard slows and stops the robot by its latest scan."""

    probability: Annotated[float, Range(0.5, 0.999999)] = 0.999
    """Probability with which a path's margin covers the cross-track error of the robot's position."""
    max_margin_m: Annotated[float, Range(0.0, 10.0)] = 0.3
    """Largest margin of a path beyond grid.clearance-m, however uncertain the pose; 0: no margin."""
    detour: Annotated[float, Range(1.0, 1000.0)] = 1.2
    """A path with a margin may be this many times as long as the shortest, else the margin is reduced."""
    guard: bool = True
    """Off: commands are not checked."""
    buffer_m: NonNegative = 0.02
    """Added to the robot's radius by the guard, to allow for range noise and for the slip of a robot that turns."""
    body_m: NonNegative = 0.2
    """Where people are expected, kept from what moves besides: the laser sees legs, and a body is wider."""
    creep: Positive = 0.1
    """Lowest speed, m/s, to which obstacles beside the robot's arc can slow it."""
