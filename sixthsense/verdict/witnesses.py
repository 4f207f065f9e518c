"""What a run leaves behind that can speak for or against its map."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sixthsense.core.geometry import Array
from sixthsense.core.laser import Scan
from sixthsense.slam.front_end import LoopClosureCounts


@dataclass(frozen=True, slots=True)
class Witnesses:
    """The wheels, the scans and the estimate of a run; poses (x, y, theta) in the world frame, m and rad.

    What a front end does not give is None: nothing is known of it then.
    """

    stamps_ns: NDArray[np.int64]
    """(S,) per scan"""
    poses: Array
    """(S, 3) final pose of the robot at each scan"""
    wheels: Array | None
    """(S, 3) the same by odometry alone; None without odometry"""
    keys: NDArray[np.int64]
    """(K,) the scan that each keyframe is, -1 for none"""
    trajectory: Array
    """(K, 3) final pose of the robot at each keyframe"""
    is_measured: NDArray[np.bool_]
    """(K,) whether wheels have measured the motion to each keyframe"""
    scans: Sequence[Scan | None]
    """(K,) scan of each keyframe; empty for a run whose scans are not at hand"""
    links: NDArray[np.int64] | None = None
    """(m, 2) keyframes that scan matching has linked"""
    matched: NDArray[np.int64] | None = None
    """(K,) number of landmarks matched at each keyframe"""
    closures: LoopClosureCounts | None = None
    """what the search for old places has come to"""
    own_front_end: str = ""
    """name of a front end that is not shipped"""
