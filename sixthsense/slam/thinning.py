"""Which keyframes leave a smoother's graph: where enough others show a place from much the same pose.

A robot that comes back to the same rooms all day adds keyframes for ever, and nothing new by them. Keeping the poses
that are there already, once a place is known, is the reduced pose graph of Johannsson, Kaess, Fallon and Leonard, ICRA
2013. What a keyframe observed is lost with it, so that nothing is counted twice.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sixthsense.core.geometry import Array, wrap_angle

AGE = 25
"""keyframes after which one is judged: nearer ones are of the same pass"""
AT_ONCE = 10
"""keyframes that leave at a time: each time costs a solution"""
_NEAR_M, _NEAR_RAD = 0.5, 0.35  # between poses from which a place looks the same
_ENOUGH = 8  # such keyframes


def is_crowded(poses: Array, kept: NDArray[np.bool_], k: int) -> bool:
    """Whether enough of the keyframes before `k` show what it shows.

    `poses` (K, 3) are those of the keyframes, and `kept` (K,) marks which are in the graph.
    """
    off = poses[:k][kept[:k]] - poses[k]
    near = (np.hypot(off[:, 0], off[:, 1]) < _NEAR_M) & (np.abs(wrap_angle(off[:, 2])) < _NEAR_RAD)
    return bool(np.count_nonzero(near) >= _ENOUGH)
