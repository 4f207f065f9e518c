"""Coverage: the area visible from the reachable poses of the robot, and the share of it that was seen."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numba
import numpy as np
from numpy.typing import NDArray

from sixthsense.core.geometry import Array, Pose
from sixthsense.core.laser import beam_bearings
from sixthsense.core.ray_casting import Beams, beams_of, cast_among, near_walls
from sixthsense.core.se2 import Triple, compose
from sixthsense.simulation.scene_grid import SceneGrid

if TYPE_CHECKING:
    from sixthsense.record.trace import Trace

Mask = NDArray[np.bool_]
Scans = NDArray[np.int32]
"""(H, W) the first scan that saw each cell, -1 for none"""

_BEAMS = 720
_SQUARE_M = 0.3  # in each of which a position is looked from
_MOST_CELLS = 4_000_000
_MOST_VIEWPOINTS = 3_000


@dataclass(frozen=True, slots=True)
class VisibleArea:
    """The cells of a grid that are visible to the robot."""

    mask: Mask
    """(H, W), indexed [row = y, col = x]"""
    origin: tuple[float, float]
    """x, y of the outer corner of cell [0, 0], world frame, metres"""
    cell_m: float
    """side of a cell, metres"""

    @property
    def square_metres(self) -> float:
        """Size of the area, m²."""
        return float(np.count_nonzero(self.mask)) * self.cell_m**2


@numba.njit(cache=True, error_model="numpy")
def _mark(laser: Triple, beams: Beams, lengths: Array, scan: int, first: Scans) -> None:
    """Set the cells of `first` below 0 on the beams from a pose of the laser to `scan`; its place and lengths in cells.

    Amanatides and Woo 1987.
    """
    height, width = first.shape
    x, y, theta = laser
    c, s = math.cos(theta), math.sin(theta)
    first_col, first_row = math.floor(x), math.floor(y)
    for i in range(lengths.shape[0]):
        col, row, length = first_col, first_row, lengths[i]
        cos, sin = c * beams.cos[i] - s * beams.sin[i], s * beams.cos[i] + c * beams.sin[i]
        steps = abs(math.floor(x + length * cos) - col) + abs(math.floor(y + length * sin) - row)
        step_x, step_y = (1 if cos > 0.0 else -1), (1 if sin > 0.0 else -1)
        per_x, per_y = abs(1.0 / cos), abs(1.0 / sin)  # inf along an axis
        next_x = (col + 1 - x if cos > 0.0 else x - col) * per_x if cos != 0.0 else np.inf
        next_y = (row + 1 - y if sin > 0.0 else y - row) * per_y if sin != 0.0 else np.inf
        for _ in range(steps + 1):
            if 0 <= row < height and 0 <= col < width and first[row, col] < 0:
                first[row, col] = scan
            if next_x < next_y:
                col += step_x
                next_x += per_x
            else:
                row += step_y
                next_y += per_y


def visible_area(
    walls: Array,
    region: tuple[float, float, float, float],
    start: tuple[float, float],
    radius: float,
    laser_range: float,
    cell_m: float = 0.05,
    glass: Array | None = None,
) -> VisibleArea:
    """The free area in the region, at least a cell away from walls, that is visible from reachable positions.

    `walls` (N, 2, 2); `region` x0 y0 x1 y1; `start` x y of a disc of `radius`; all in the world frame, metres. A
    position is reachable if the disc touches no wall and no `glass` (G, 2, 2) there and it is connected to the start;
    beams pass through glass. A full circle of beams of
    `laser_range` is cast from one reachable position in each square of 0.3 m. Positions lie within the
    bounds of region, walls and start. In a very large scene, cells and squares are enlarged to bound memory and time.
    """
    low, high = np.array(region[:2]), np.array(region[2:])
    # Positions beyond the laser's range from the region see nothing of it, but may connect others that do.
    solid = walls if glass is None else np.concatenate([walls, glass])
    corners = np.concatenate([solid.reshape(-1, 2), [low, high, start]])
    bottom, top = corners.min(axis=0), corners.max(axis=0)
    while np.prod(np.ceil((top - bottom) / cell_m) + 3) > _MOST_CELLS:
        cell_m *= 2.0
    # The corner of the region coincides with a corner of cells.
    origin: Array = low - (np.ceil((low - bottom) / cell_m) + 1.0) * cell_m
    width, height = np.ceil((top - origin) / cell_m).astype(np.int64) + 1
    # A disc smaller than a cell must not pass from one cell to the next through a wall between their centres.
    disc = max(radius, 0.51 * cell_m)
    reach_m = max(disc, cell_m) + cell_m
    grid = SceneGrid(walls, origin, origin + cell_m * np.array([width, height]), cell_m, reach_m)
    height, width = grid.clearance_m.shape  # a cell more where a quotient is rounded up
    clearances = grid.clearance_m.copy()
    grid.add(solid[len(walls) :], reach_m)
    x = origin[0] + (np.arange(width) + 0.5) * cell_m
    y = origin[1] + (np.arange(height) + 0.5) * cell_m

    # The free space around the start may be smaller than a cell, so that none is reachable.
    reachable = grid.reachable(grid.clearance_m >= disc, np.asarray(start, dtype=np.float64), 1.5 * cell_m)
    reachable &= (np.maximum(np.maximum(low[1] - y, y - high[1]), 0.0) <= laser_range)[:, None]
    reachable &= (np.maximum(np.maximum(low[0] - x, x - high[0]), 0.0) <= laser_range)[None, :]

    views = enumerate(_viewpoints(reachable, max(1, round(_SQUARE_M / cell_m))))
    lasers = {k: Pose(x[col], y[row]) for k, (row, col) in views}
    bearings = 2.0 * math.pi * np.arange(_BEAMS, dtype=np.float64) / _BEAMS
    inside = ((y > low[1]) & (y < high[1]))[:, None] & ((x > low[0]) & (x < high[0]))[None, :]
    area = VisibleArea(inside & (clearances >= cell_m), (float(origin[0]), float(origin[1])), cell_m)
    mask = area.mask & (_first_seen(area, lasers, bearings, laser_range, walls) >= 0)
    mask.flags.writeable = False
    return replace(area, mask=mask)


def coverage(area: VisibleArea, lasers: Array, bearings: Array, max_range: float, walls: Array) -> Array:
    """(S,) the share, 0 to 1, of the visible area's cells on a beam of any scan so far; NaN if the area is empty.

    `lasers` (S, 3) true poses of the laser at the scans, `bearings` (N,) of its beams, evenly spaced, `walls`
    (M, 2, 2), metres and radians. The beams are cast again, without noise. Scans from the pose of the previous scan are
    skipped.
    """
    if not area.mask.any():
        return np.full(len(lasers), math.nan)
    spacing = abs(float(bearings[1] - bearings[0])) if len(bearings) > 1 else math.inf
    seats: dict[int, Pose] = {}
    last = None
    for k, laser in enumerate(map(Pose.from_array, lasers)):
        moved = None if last is None else last.inverse() @ laser
        if moved is None or math.hypot(moved.x, moved.y) >= 0.5 * area.cell_m or abs(moved.theta) >= 0.5 * spacing:
            last = seats[k] = laser
    known = _first_seen(area, seats, bearings, max_range, walls)[area.mask]
    return np.asarray(np.cumsum(np.bincount(known[known >= 0], minlength=len(lasers))) / len(known))


def coverage_of(trace: Trace) -> tuple[VisibleArea, Array]:
    """The area that is visible to the robot of a run, and its `coverage` after each scan.

    The trace must have truth and a scene.
    """
    assert trace.scene is not None
    laser, walls = trace.config.laser, trace.scene.walls
    poses = np.array(trace.truths).reshape(-1, 3)
    start = (float(poses[0, 0]), float(poses[0, 1]))
    region = trace.config.region or trace.scene.region
    area = visible_area(walls, region, start, trace.radius_m, laser.max_range, glass=trace.scene.glass)
    lasers = compose(poses, np.array(laser.mount))
    return area, coverage(area, lasers, beam_bearings(laser), laser.max_range, walls)


def _first_seen(
    area: VisibleArea, lasers: Mapping[int, Pose], bearings: Array, max_range: float, walls: Array
) -> Scans:
    """(H, W) the first scan with a beam on each cell, -1 for none; `lasers` are the poses of the laser by scan."""
    first = np.full(area.mask.shape, -1, dtype=np.int32)
    beams, near = beams_of(bearings), near_walls(walls, max_range)
    for scan, laser in lasers.items():
        ranges = cast_among(laser, beams, near(laser.x, laser.y), max_range)
        x, y = ((laser.position - area.origin) / area.cell_m).tolist()
        _mark((x, y, laser.theta), beams, np.minimum(ranges, max_range) / area.cell_m, scan, first)
    return first


def _viewpoints(reachable: Mask, step: int) -> NDArray[np.int64]:
    """(K, 2) row and col of the most central cell of `reachable` in each square of `step` cells that has any."""
    rows, cols = np.nonzero(reachable)
    while True:
        square = np.stack([rows // step, cols // step], axis=1)
        keys = square[:, 0] * (reachable.shape[1] // step + 1) + square[:, 1]
        off_centre = np.abs(rows % step - step // 2) + np.abs(cols % step - step // 2)
        order = np.lexsort((off_centre, keys))
        first = order[np.flatnonzero(np.diff(keys[order], prepend=-1))]
        if len(first) <= _MOST_VIEWPOINTS:
            return np.stack([rows[first], cols[first]], axis=1)
        step = math.ceil(1.2 * step)
