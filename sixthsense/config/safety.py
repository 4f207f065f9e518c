"""Configuration of what keeps the robot clear of obstacles: the margin of its paths, and the guard of its drive."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from sixthsense.config.section import Range, Section
from sixthsense.config.values import NonNegative, Positive


@dataclass(frozen=True)
class SafetyConfig(Section):
    """Paths keep a margin where there is room for it; the guard slows and stops the robot by its latest scan."""

    probability: Annotated[float, Range(0.5, 0.999999)] = 0.999
    """With which a path's margin covers the error of the robot's position across it."""
    max_margin_m: Annotated[float, Range(0.0, 10.0)] = 0.3
    """Beyond grid.clearance-m a path keeps at most this, however unsure the robot is; 0: no margin."""
    detour: Annotated[float, Range(1.0, 1000.0)] = 1.2
    """A path with a margin may be this much longer than the shortest, else the margin gives way."""
    guard: bool = True
    """Off: commands reach the drive unchecked."""
    buffer_m: NonNegative = 0.01
    """The guard stops the robot this far from a return: range noise."""
    creep: Positive = 0.1
    """Beside obstacles, however near, the guard lets the robot pass at this speed, m/s."""
