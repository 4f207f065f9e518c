"""Figures of a run beside its map: over time, of one scan, of the way planned; each draws on the axes it is given."""

from __future__ import annotations

from sixthsense.figures.navigation import draw_exploration, draw_hits, draw_path, draw_robot, draw_seen
from sixthsense.figures.overtime import COMPONENTS, draw_coverage, draw_error, draw_nees, draw_nis, draw_stages
from sixthsense.figures.scan import draw_beams, draw_detections, draw_partitions, draw_returns

__all__ = [
    "COMPONENTS",
    "draw_beams",
    "draw_coverage",
    "draw_detections",
    "draw_error",
    "draw_exploration",
    "draw_hits",
    "draw_nees",
    "draw_nis",
    "draw_partitions",
    "draw_path",
    "draw_returns",
    "draw_robot",
    "draw_seen",
    "draw_stages",
]
