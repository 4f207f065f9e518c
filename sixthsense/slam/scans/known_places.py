"""Known scans as places: what is around one of them in some metres of travel.

A place is drawn from one pass, by consecutive scans: those of two passes do not fit each other before the loop between
them is closed.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from sixthsense.core.geometry import Array
from sixthsense.core.se2 import between
from sixthsense.slam.scans.graph import REACH_M, PlacedScans
from sixthsense.slam.scans.places import BINS, NEAR_M, Pyramid, appearance, pyramid, surfaces

RECENT_M = 6.0
"""travel of the submap that is searched for"""
LEAST_POINTS = 60
"""with fewer points of the last metres what is far away counts, too; with fewer even so there is no search"""
HALF_M = 5.0
"""of a place to either side of its anchor"""
BACK_M = 2.0 * RECENT_M
"""travel over which scans are followed back and votes count"""
_MOST_SUBMAPS = 32  # that are kept
CARRIED_M = 2.0 * (HALF_M + BACK_M + REACH_M)
"""of travel where the robot was carried, and from one run to another: no place has surroundings on both sides"""


class KnownPlaces:
    """The scans among which a place is sought."""

    def __init__(self, scans: PlacedScans) -> None:
        self._scans = scans
        self._anchors: list[int] = []
        """scans that places are around, of each of which it is final what it looks like"""
        self._looks = np.zeros((0, BINS))
        """what the places around them look like"""
        self._submaps: dict[tuple[int, float, int], Pyramid] = {}
        """by an anchor, what its points were limited to, and the number of its scans"""
        self._rows = np.zeros(0, dtype=np.int64)
        """places that are sought among"""
        self._past, self._known = 0, self._rows
        """submaps are of scans before; and all that places are judged by"""

    @property
    def keys(self) -> NDArray[np.int64]:
        """(n,) the anchors' rows in the store."""
        return np.array(self._anchors, dtype=np.int64)[self._rows]

    @property
    def anchors(self) -> Array:
        """(n, 3) their poses."""
        return np.asarray(self._scans.poses[self.keys])

    @property
    def looks(self) -> Array:
        """(n, BINS) what the places look like."""
        return np.asarray(self._looks[self._rows])

    def seek(self, old: NDArray[np.int64], known: NDArray[np.int64]) -> None:
        """Seek among the scans `old`, ascending; places are judged by all the scans `known`."""
        self._past, self._known = int(old[-1]) + 1 if len(old) else 0, known
        self._describe()
        self._rows = np.flatnonzero(np.isin(self._anchors, old))

    def forget(self) -> None:
        """Draw submaps anew: the scans have moved."""
        self._submaps = {}

    def surroundings(self, place: int) -> NDArray[np.int64]:
        """Rows of the scans that are known along the way there."""
        travelled_m = self._scans.travelled_m
        off_m = np.abs(travelled_m[self._known] - travelled_m[self.keys[place]])
        return np.asarray(self._known[off_m < HALF_M + BACK_M + REACH_M])

    def submap(self, place: int, range_m: float) -> Pyramid:
        """What can be seen on the last metres to any pose at a place, in its anchor's frame, of returns in a range.

        A robot that comes the other way sees what lay behind it.
        """
        keys, at = self._around(self.keys[place], HALF_M + RECENT_M)
        which = int(self.keys[place]), range_m, len(keys)  # there are more while the robot drives on from there
        if which not in self._submaps:
            if len(self._submaps) == _MOST_SUBMAPS:
                self.forget()
            found = surfaces(self._scans.store.returns, keys, at, range_m)
            self._submaps[which] = pyramid(np.ascontiguousarray(found[:, :2]))
        return self._submaps[which]

    def _around(self, anchor: int | np.int64, half_m: float) -> tuple[NDArray[np.int64], Array]:
        """Scans of the way around an anchor, and their poses in its frame."""
        travelled_m = self._scans.travelled_m[: self._past]
        keys = np.flatnonzero(np.abs(travelled_m - travelled_m[anchor]) < half_m)
        return keys, between(self._scans.poses[anchor], self._scans.poses[keys])

    def _describe(self) -> None:
        """Add places whose submaps are complete with the scans so far."""
        travelled_m = self._scans.travelled_m[: self._past]
        end_m = float(self._scans.travelled_m[min(self._past, len(self._scans.travelled_m) - 1)])
        while len(travelled_m):
            next_m = float(self._scans.travelled_m[self._anchors[-1]]) + REACH_M if self._anchors else 0.0
            anchor = int(np.searchsorted(travelled_m, next_m))
            if anchor == len(travelled_m) or travelled_m[anchor] + HALF_M >= end_m:
                return
            look = appearance(surfaces_around(self._scans, *self._around(anchor, HALF_M))[0])
            self._looks = np.vstack([self._looks, look])
            self._anchors.append(anchor)


def of_last_metres(travelled_m: Array, key: int) -> NDArray[np.int64]:
    """The scans of the last metres before `key`, and itself; `travelled_m` (K,) is at each."""
    return np.flatnonzero(travelled_m[: key + 1] > travelled_m[key] - RECENT_M)


def surfaces_around(scans: PlacedScans, keys: NDArray[np.int64], at: Array) -> tuple[Array, float]:
    """(N, 4) surfaces of scans in the frame of their poses `at` (n, 3), and how far returns are at most.

    Where there is too little nearby, all that is seen counts.
    """
    near = surfaces(scans.store.returns, keys, at)
    if len(near) >= LEAST_POINTS:
        return near, NEAR_M
    return surfaces(scans.store.returns, keys, at, math.inf), math.inf
