"""Configuration of the front end of scans."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from sixthsense.config.section import Range, Section
from sixthsense.config.values import Positive


@dataclass(frozen=True)
class ScansConfig(Section):
    """Alignment of scans with earlier scans, and loop closures (front_end scan-matching)."""

    max_range_m: Positive = 30.0
    """Returns farther away are not used."""
    loop_closures: bool = True
    """Off: scans are linked to recent ones alone, and no loop is closed."""
    search_radius_m: Annotated[float, Range(0.0, 100.0)] = 15.0
    """Old places up to this far from the estimate are searched for a loop closure, if its uncertainty allows them; 0:
    only places that are certain are linked."""
    min_score: Annotated[float, Range(0.3, 1.0)] = 0.62
    """Least share of a submap's points that a loop closure must explain; lower finds more loop closures, and more wrong
    ones."""
    final_pass: bool = True
    """At the end align the scans between keyframes once more."""
