"""Where the robot fits without the clearance that it keeps, and the gaps that close its way."""

from __future__ import annotations

import math

import numpy as np
from scipy import ndimage

from sixthsense.core.geometry import Array, Pose
from sixthsense.navigation.driving_limits import track_cells
from sixthsense.navigation.gridsearch import Distances, cell_before_gap
from sixthsense.navigation.map_window import MapWindow
from sixthsense.slam.mapping.freespace import Bools
from sixthsense.slam.mapping.inflation import stamped


def too_near(obstacles: Bools, radius: float) -> Bools:
    """(H, W) the cells whose centre is nearer to an obstacle cell's centre than a radius, in cells."""
    reach = math.floor(radius) + 1
    offsets = np.arange(-reach, reach + 1)
    return stamped(obstacles, np.argwhere(np.hypot(offsets[:, None], offsets[None, :]) < radius) - reach)


def fitting_cells(window: MapWindow, pose: Pose, radius_m: float, least: int) -> Bools:
    """(H, W) the seen cells where the robot fits, of connected parts with at least so many cells or with the robot."""
    fitting = window.seen & ~too_near(window.obstacles, radius_m / window.cell_m)
    labels, _ = ndimage.label(fitting)
    large = np.bincount(labels.ravel()) >= least
    large[labels[window.cell(pose.position)]] = True
    return np.asarray(fitting & large[labels])


def distances_without_clearance(
    window: MapWindow, pose: Pose, radius_m: float, passed: Bools | None = None
) -> Distances:
    """Distances, in cells, from a robot that may come as near to an obstacle cell's centre as its radius.

    It may also drive where it has `passed` (H, W).
    """
    blocked = too_near(window.obstacles, radius_m / window.cell_m)
    if passed is not None:
        blocked &= ~passed
    here = window.cell(pose.position)
    blocked[here] = False
    return Distances(window.seen & ~blocked, blocked, *here)


def gap_on_the_way(
    window: MapWindow, pose: Pose, goal: Array, reachable: Bools, radius_m: float, positions: Array
) -> tuple[int, int] | None:
    """The last of the `reachable` cells (H, W) before the gap that closes the way to a goal (2,); None without one.

    The gap is one that only the clearance closes, or one that the robot, which has been at `positions` (N, 2), has come
    through.
    """
    corner = window.first[1] * window.cell_m, window.first[0] * window.cell_m
    passed = track_cells(positions, corner, window.cell_m, window.seen.shape)
    distances = distances_without_clearance(window, pose, radius_m, passed).to_all()
    return cell_before_gap(reachable, distances, *window.cell(goal))
