"""Configuration of exploration: choice of viewpoints, end of the task, and loop closures for an uncertain pose."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from sixthsense.config.section import Range, Section
from sixthsense.config.values import NonNegative, Positive, PositiveCount


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
