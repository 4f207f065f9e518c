"""Views of a map of cells: what a laser would see in it, cast on demand, and aligned with like any other scan.

The places of the map lie around free cells some metres apart; what is seen from there and from those around it that are
in sight is what a place looks like.
"""

from __future__ import annotations

import math
from functools import cached_property

import numba
import numpy as np
from numpy.typing import NDArray

from sixthsense.config import GridConfig
from sixthsense.core.geometry import Array, Pose
from sixthsense.core.laser import Scan
from sixthsense.slam.mapping.evidence import are_obstacles
from sixthsense.slam.mapping.freespace import ahead, ray_from
from sixthsense.slam.mapping.submap import Submap
from sixthsense.slam.scans.place_search import ANCHORS_APART_M, HALF_M, surfaces_around
from sixthsense.slam.scans.places import BINS, Pyramid, appearance, pyramid
from sixthsense.slam.scans.returns import ScanStore, full_turn

_APART_M = 0.5  # side of the tiles in which one view stands for all
_UNSEEN, _FREE, _OBSTACLE = range(3)


class MapViews:
    """Scans of two kinds: views of the map, in its frame, and those of a robot, in a frame of its own.

    The map is divided into places, which a scan of the robot is searched in.
    """

    def __init__(self, evidence: Submap, config: GridConfig, scan: Scan) -> None:
        """Begin with a map, and a scan of the laser that it is looked at with."""
        self._cell_m = config.cell_m
        top, left, bottom, right = evidence.box
        self._corner = np.array([left, top]) * config.cell_m
        self._cells = np.full((bottom - top, right - left), _UNSEEN, dtype=np.uint8)
        rows, cols = evidence.cells[:, 0] - top, evidence.cells[:, 1] - left
        self._cells[rows, cols] = np.where(evidence.seen, _FREE, _UNSEEN)
        is_obstacle = are_obstacles(evidence.hits, evidence.passes, config)
        self._cells[rows[is_obstacle], cols[is_obstacle]] = _OBSTACLE
        hits = np.zeros(self._cells.shape, dtype=np.float32)
        hits[rows, cols] = evidence.hits
        self._surfaces = _surfaces(hits)
        self._rows: dict[tuple[int, int], int] = {}
        """of the view in each tile"""
        self.poses = np.zeros((0, 3))
        """of all scans, each in its own frame"""
        self.travelled_m = np.zeros(0)
        """at each scan of the robot; minus infinity at the views of the map"""
        self._max_range = scan.max_range
        self.usual_agreement = 1.0
        """nothing is known of what has changed since the map was made"""
        self._bearings = full_turn(scan)
        self.store = ScanStore(math.inf, self._bearings)

    def add(self, scan: Scan, pose: Pose, travelled_m: float) -> int:
        """Keep a scan of the robot, whose laser is at `pose` in the robot's own frame; its row."""
        return self._keep(scan, pose.array(), travelled_m)

    @cached_property
    def anchors(self) -> Array:
        """(n, 3) poses of heading 0: the free cell that is nearest to the middle of each square of the map."""
        free = np.argwhere(self._cells == _FREE)[:, ::-1]
        at = (free + 0.5) * self._cell_m + self._corner
        squares = np.floor(at / ANCHORS_APART_M).astype(np.int64)
        off = np.hypot(*(at - (squares + 0.5) * ANCHORS_APART_M).T)
        order = np.lexsort((off, squares[:, 1], squares[:, 0]))
        _, first = np.unique(squares[order], axis=0, return_index=True)
        return np.column_stack([at[order[first]], np.zeros(len(first))])

    @cached_property
    def looks(self) -> Array:
        """(n, BINS) what is seen from each place and from those around it that are in sight."""
        anchors, looks = self.anchors, np.zeros((len(self.anchors), BINS))
        for k, anchor in enumerate(anchors):
            off = anchors[:, :2] - anchor[:2]
            around = np.flatnonzero(np.hypot(off[:, 0], off[:, 1]) < HALF_M)
            seen = [j for j in around.tolist() if j == k or self._is_in_sight(anchor, off[j])]
            views = np.concatenate([self.partners(0, anchors[j], 1) for j in seen])
            looks[k] = appearance(surfaces_around(self, views, self.poses[views] - anchor)[0])
        return looks

    def submap(self, place: int, range_m: float) -> Pyramid:
        """All obstacles of the map, in the frame of a place."""
        x, y, _ = self.anchors[place]
        return self._whole._replace(x0=self._whole.x0 - x, y0=self._whole.y0 - y)

    def surroundings(self, place: int) -> MapViews:
        """The views of the map."""
        return self

    @cached_property
    def _whole(self) -> Pyramid:
        """The obstacles, map's frame."""
        rows, cols = np.nonzero(self._cells == _OBSTACLE)
        return pyramid((np.column_stack([cols, rows]) + 0.5) * self._cell_m + self._corner)

    def _is_in_sight(self, at: Array, off: Array) -> bool:
        """Whether no obstacle is between a pose (3,) and a point that is `off` (2,) from it."""
        x, y = (at[:2] - self._corner) / self._cell_m
        bearing = np.array([math.atan2(off[1], off[0])])
        return math.isinf(_cast(self._cells, self._surfaces, x, y, bearing, math.hypot(*off) / self._cell_m)[0])

    def partners(self, key: int, at: Array, most: int) -> NDArray[np.int64]:
        """The row of the view from a pose (3,) in the map; `key` is the scan that is compared with it."""
        tile = int(at[0] // _APART_M), int(at[1] // _APART_M)
        if tile not in self._rows:
            self._rows[tile] = self._cast(at)
        return np.array([self._rows[tile]])

    def _cast(self, at: Array) -> int:
        """Keep the view from a place in the map; its row."""
        first, step, beams = self._bearings[:3]
        x, y = (at[:2] - self._corner) / self._cell_m
        bearings = first + step * np.arange(beams, dtype=np.float64)
        ranges = self._cell_m * _cast(self._cells, self._surfaces, x, y, bearings, self._max_range / self._cell_m)
        view = Scan(ranges.astype(np.float32), np.float32(first), np.float32(step), self._max_range)
        return self._keep(view, np.array([at[0], at[1], 0.0]), -math.inf)

    def _keep(self, scan: Scan, pose: Array, travelled_m: float) -> int:
        self.store.put(scan)
        self.travelled_m = np.append(self.travelled_m, travelled_m)
        self.poses = np.vstack([self.poses, pose])
        return self.store.keep()


@numba.njit(cache=True, error_model="numpy")
def _surfaces(hits: NDArray[np.float32]) -> NDArray[np.float32]:
    """(H, W, 2) x and y of the surface in each cell that was hit, in cells: the centre of the hits in and around it.

    Where returns fall into two rows of cells, the wall lies between these.
    """
    height, width = hits.shape
    out = np.zeros((height, width, 2), np.float32)
    for j in range(height):
        for i in range(width):
            if hits[j, i] == 0.0:
                continue
            total = x = y = 0.0
            for b in range(max(j - 1, 0), min(j + 2, height)):
                for a in range(max(i - 1, 0), min(i + 2, width)):
                    total, x, y = total + hits[b, a], x + hits[b, a] * (a + 0.5), y + hits[b, a] * (b + 0.5)
            out[j, i, 0], out[j, i, 1] = x / total, y / total
    return out


@numba.njit(cache=True, error_model="numpy")
def _cast(
    cells: NDArray[np.uint8], surfaces: NDArray[np.float32], x: float, y: float, bearings: Array, reach: float
) -> Array:
    """(N,) distances to the first obstacle in each direction, in cells; infinite where none is seen.

    A beam ends beside the surface in the obstacle's cell.
    """
    ranges = np.full(len(bearings), np.inf)
    height, width = cells.shape
    for k in range(len(bearings)):
        c, s = math.cos(bearings[k]), math.sin(bearings[k])
        ray = ray_from(x, y, c, s)
        while ray.gone < reach and 0 <= ray.col < width and 0 <= ray.row < height:
            i, j = ray.col, ray.row
            if cells[j, i] == _UNSEEN:
                break
            if cells[j, i] == _OBSTACLE:
                ranges[k] = (surfaces[j, i, 0] - x) * c + (surfaces[j, i, 1] - y) * s
                break
            ray = ahead(ray)
    return ranges
