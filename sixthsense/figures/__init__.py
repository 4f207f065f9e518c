"""Figures of a run besides its map: quantities over time, one scan, one filter step, planning and exploration.

Each function draws on given axes. `new_axes` makes a figure. `record` runs a configuration and keeps its keyframes.
"""

from __future__ import annotations

from sixthsense.figures.canvas import draw_truth, legend, new_axes, slider, window
from sixthsense.figures.navigation import draw_exploration, draw_hits, draw_path, draw_region, draw_robot, draw_seen
from sixthsense.figures.overtime import COMPONENTS, draw_coverage, draw_error, draw_nees, draw_nis, draw_stages
from sixthsense.figures.plot import draw_walls_at, draw_way
from sixthsense.figures.recording import Recording, features_of, record, worst_culled
from sixthsense.figures.scan import (
    compare_features,
    draw_beams,
    draw_change,
    draw_correlation,
    draw_detections,
    draw_innovations,
    draw_partitions,
    draw_returns,
    draw_state,
    draw_wall_bands,
    strays_m,
)
