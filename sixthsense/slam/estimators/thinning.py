"""Which keyframes leave a smoother's graph: where enough others show a place from much the same pose.

A robot that comes back to the same rooms all day adds keyframes for ever, and nothing new by them. Keeping the poses
that are there already, once a place is known, is the reduced pose graph of Johannsson, Kaess, Fallon and Leonard, ICRA
2013. What a keyframe observed is lost with it, so that nothing is counted twice.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from sixthsense.core.geometry import Array, wrap_angle

OLD_AGE = 25
"""keyframes; nearer ones are of the same pass, and an older one is judged"""
PERIOD = 10
"""keyframes between two times that all poses are read, and that leave at a time: each costs a solution"""
_NEAR_M, _NEAR_RAD = 0.5, 0.35  # between poses from which a place looks the same
_ENOUGH = 8  # such keyframes


class Thinning:
    """Judges each keyframe of a graph once, when it is old enough."""

    def __init__(self) -> None:
        self._next = 1
        """the first keyframe that was not judged yet"""
        self._spare: list[int] = []
        """keyframes that will leave with the next ones"""

    def leaving(self, poses: Array, kept: NDArray[np.bool_], is_needed: Callable[[int], bool]) -> list[int]:
        """Keyframes that leave, ascending; most often none.

        `poses` (K, 3) are those of all keyframes, and `kept` (K,) marks which are in the graph. One that `is_needed`
        stays.
        """
        kept, end = kept.copy(), len(poses) - OLD_AGE
        kept[self._spare] = False
        for k in range(self._next, end):
            if is_crowded(poses, kept, k) and not is_needed(k):
                self._spare.append(k)
                kept[k] = False
        self._next = max(self._next, end)
        if len(self._spare) < PERIOD:
            return []
        leaving, self._spare = self._spare, []
        return leaving


def is_crowded(poses: Array, kept: NDArray[np.bool_], k: int) -> bool:
    """Whether enough of the keyframes before `k` show what it shows; arguments as of `Thinning.leaving`."""
    off = poses[:k][kept[:k]] - poses[k]
    near = (np.hypot(off[:, 0], off[:, 1]) < _NEAR_M) & (np.abs(wrap_angle(off[:, 2])) < _NEAR_RAD)
    return bool(np.count_nonzero(near) >= _ENOUGH)
