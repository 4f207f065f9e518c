"""Configuration of exploration: where to look next, when it is done, and what to do about a pose known badly."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from sixthsense.config.section import Range, Section
from sixthsense.config.values import NonNegative, Positive, PositiveCount


@dataclass(frozen=True)
class ExploreConfig(Section):
    """Where to look next, and when all is seen (report section 4.5)."""

    method: Literal["frontier", "random"] = "frontier"
    """frontier: the view that shows most in least time; random: places drawn in the largest unseen area (the report's
    idea)."""
    return_home: bool = True
    """Drive back to the start when all is seen."""
    gain_exponent: Annotated[float, Range(0.0, 4.0)] = 0.15
    """A view is worth its gain, m^2, to this power, per second it takes; 0: the nearest first."""
    overhead_s: Positive = 1.0
    """Added to the time to a view, so that the nearest is not worth all the others."""
    tries: PositiveCount = 2
    """What was not seen from so many viewpoints, with a turn around at each, is given up."""
    dust: Annotated[float, Range(0.0, 1.0)] = 0.001
    """Specks that are unseen are left so, the smallest first, up to this share of the area seen."""
    margin_m: NonNegative = 1.0
    """How far outside the region the robot may drive, to get around a wall at its edge; farther, as far as the laser
    reaches, when nothing else is left to see and what is unseen in the region goes on there."""
    least_area_m2: NonNegative = 0.02
    """A place that was given up counts as left unseen if it is at least so large."""
    revisit: bool = True
    """Drive back to a place where the pose was known well when it no longer is."""
    revisit_sigma_m: Positive = 0.1
    """The pose is no longer known well when its position's largest sigma is above this."""
