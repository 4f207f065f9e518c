"""Configuration of safety: the margin of paths, and the guard that checks commands."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from sixthsense.config.section import Range, Section
from sixthsense.config.values import NonNegative, Positive


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
