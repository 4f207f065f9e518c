"""Rooms to look at, and the scans that a laser takes of them."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from sixthsense.config import GridConfig, LaserConfig
from sixthsense.core.geometry import Array, Pose
from sixthsense.core.laser import Scan, beam_bearings
from sixthsense.core.ray_casting import cast_rays
from sixthsense.slam.estimators import LandmarkPrior
from sixthsense.slam.mapping.grid import Grid
from sixthsense.slam.prior_map import KeyScans, PriorMap


def outline(*corners: tuple[float, float]) -> Array:
    """(n, 2, 2) walls from corner to corner and back to the first one."""
    points = np.array(corners, dtype=np.float64)
    return np.stack([points, np.roll(points, -1, axis=0)], axis=1)


def box(x: float, y: float, width: float, height: float) -> Array:
    """(4, 2, 2) the sides of a rectangle, counter-clockwise from its lower left corner."""
    return outline((x, y), (x + width, y), (x + width, y + height), (x, y + height))


def look(
    pose: Pose,
    walls: Array,
    laser: LaserConfig | None = None,
    sigma: float = 0.0,
    rng: np.random.Generator | int = 0,
) -> Scan:
    """A scan of walls (W, 2, 2) from a robot at `pose`, with noise of `sigma`, m, drawn from `rng` or a seed."""
    laser = laser or LaserConfig()
    ranges = cast_rays(pose @ Pose(*laser.mount), beam_bearings(laser), walls, laser.max_range)
    noise = sigma * np.random.default_rng(rng).standard_normal(len(ranges)) if sigma else 0.0
    return Scan.from_config(ranges + noise, laser)


def map_of(walls: Array, poses: Iterable[Pose], laser: LaserConfig) -> PriorMap:
    """A prior map without landmarks: the grid of noisy scans of walls from these poses."""
    grid, none = Grid(GridConfig(), 0.2), np.zeros((0, 2))
    poses = list(poses)
    scans = [look(pose, walls, laser, 0.01, 7) for pose in poses]
    for pose, scan in zip(poses, scans, strict=True):
        grid.add(pose, scan)
    landmarks = LandmarkPrior(np.zeros(0, np.int64), none, np.zeros(0, bool), np.zeros((0, 0)), np.zeros((0, 2, 2)))
    known = KeyScans(scans, np.array([pose.array() for pose in poses]))
    return PriorMap("earlier", "", landmarks, {}, grid.submap(), GridConfig().cell_m, known)
