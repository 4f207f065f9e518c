"""Returns of what moves: those that lie where scans of the last seconds saw through."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import replace
from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from sixthsense.core.geometry import Array, Pose
from sixthsense.core.laser import Scan
from sixthsense.core.returns import NO_BEAM, Bearings, cell_of

_BETWEEN_NS, _KEPT = 500_000_000, 60
"""time between two scans that are compared with, and how many: someone who has stood for longer is as good as a wall"""
_STANDS_NS = 3_000_000_000
"""what no scan of so long has seen through stands"""
_BEYOND_M = 0.15
"""how far behind a return the earlier scan must have seen: more than a foot moves while someone stands"""
_TOLERANCE_M = 0.05
"""error of the pose over these seconds, across the beam: all beams as near to the return must have seen farther"""
_TOLERANCE_RAD = 0.02
"""the same of the heading"""
_LEVER_M = 3.0
"""distance at which an error of the heading is one of the pose"""
_LEAST_SCANS = 2
"""that saw through"""
_MOST_SHARE = 0.5
"""where more of a scan seems to move, it is the pose that has moved"""


class Moving(NamedTuple):
    """Returns of what moves."""

    points_robot: Array
    """(M, 2) metres, robot's frame"""
    standing_robot: Array
    """(K, 2) those of what has been there for some seconds"""


NOTHING_MOVES = Moving(np.zeros((0, 2)), np.zeros((0, 2)))


class View(NamedTuple):
    """What an earlier scan saw, from where."""

    stamp_ns: int
    pose: Array
    """(3,) `T_world_laser`"""
    cells: Bearings
    ranges: Array
    """(cells,) of its returns by bearing, metres; inf where nothing was met, and `NO_BEAM` for no evidence"""


@numba.njit(cache=True, error_model="numpy")
def _count_seen_through(points: Array, pose: Array, cells: Bearings, ranges: Array, counts: NDArray[np.int64]) -> None:
    """Add 1 to `counts` (N,), up to `_LEAST_SCANS`, for `points` (N, 2), world frame, that a view saw through."""
    for i in range(len(points)):
        if counts[i] >= _LEAST_SCANS:
            continue  # that is enough
        dx, dy = points[i, 0] - pose[0], points[i, 1] - pose[1]
        distance = np.hypot(dx, dy)
        if not 2.0 * _TOLERANCE_M < distance < np.inf:  # also NaN
            continue
        middle = int(np.floor(cell_of(cells, np.arctan2(dy, dx) - pose[2]) + 0.5))
        reach = 1 + int((_TOLERANCE_M / distance + _TOLERANCE_RAD) / cells.spacing)
        through = True
        for k in range(middle - reach, middle + reach + 1):
            if not (cells.closed or 0 <= k < cells.beams) or not ranges[k % cells.beams] > distance + _BEYOND_M:
                through = False
                break
        counts[i] += through


class MovingReturns:
    """Keeps the scans of the last seconds, and takes the returns of what moves out of a scan."""

    def __init__(self, no_return_passes: bool) -> None:
        """Begin without a scan; `no_return_passes` is whether a beam without a return saw up to its maximum."""
        self._no_return = np.inf if no_return_passes else NO_BEAM
        self._views: deque[View] = deque(maxlen=_KEPT)

    def split(self, scan: Scan, T_world_robot: Pose, stamp_ns: int) -> tuple[Scan, Moving]:
        """The scan with NaN, no evidence, in the place of returns of what moves; and these."""
        counts = np.zeros(len(scan.ranges), dtype=np.int64)
        points_robot = scan.points_robot
        points = T_world_robot @ points_robot
        recent = np.ones(len(counts), dtype=np.bool_)
        is_recent = True
        for view in reversed(self._views):
            if is_recent and stamp_ns - view.stamp_ns > _STANDS_NS:
                recent, is_recent = counts > 0, False
            _count_seen_through(points, view.pose, view.cells, view.ranges, counts)
        moving = scan.is_return & (counts >= _LEAST_SCANS)
        count = np.count_nonzero(moving)
        if count == 0 or count > _MOST_SHARE * np.count_nonzero(scan.is_return):
            return scan, NOTHING_MOVES
        still = replace(scan, ranges=np.where(moving, np.float32(np.nan), scan.ranges))
        return still, Moving(points_robot[moving], points_robot[moving & ~recent])

    def keep(self, scan: Scan, T_split: Pose, T_world_robot: Pose, stamp_ns: int) -> None:
        """Compare later scans with this one, too, which was split at one pose and is estimated at another now.

        Where that has moved far, as after a loop closure, what earlier scans saw lies elsewhere.
        """
        correction = T_split.inverse() @ T_world_robot
        if math.hypot(correction.x, correction.y) + _LEVER_M * abs(correction.theta) > _BEYOND_M:
            self._views.clear()
        if not self._views or stamp_ns - self._views[-1].stamp_ns >= _BETWEEN_NS:
            ranges = scan.by_bearing[:, 2].astype(np.float64)
            ranges[ranges == 0.0] = self._no_return
            self._views.append(View(stamp_ns, (T_world_robot @ scan.T_robot_laser).array(), scan.cells, ranges))
