"""Thinning: where enough keyframes show a place from much the same pose, later ones leave the graph.

A robot that comes back to the same rooms all day adds keyframes for ever, and says nothing new by them. Keeping the
poses that are there already, once a place is known, is the reduced pose graph of Johannsson, Kaess, Fallon and Leonard,
ICRA 2013. A keyframe leaves some time after it was made. Its links are lost, so that nothing is counted twice.
"""

from __future__ import annotations

import numpy as np

from sixthsense.core.geometry import wrap_angle
from sixthsense.slam.scans.closing import Closings
from sixthsense.slam.scans.graph import OLD_AGE, RECENT, ScanGraph

_BATCH = 10  # keyframes that leave together: each time costs the estimator a solution
_NEAR_M, _NEAR_RAD = 0.5, 0.35  # between poses from which a place looks the same
_ENOUGH = 8  # such keyframes
_LEAST_OLD_LINKS = 2  # of a keyframe whose place is known


class Thinning:
    """Which keyframes leave the graph."""

    def __init__(self, graph: ScanGraph, closings: Closings) -> None:
        self._graph, self._closings = graph, closings
        self._next = 1
        """the first keyframe that was not judged yet"""
        self._spare: list[int] = []
        """keyframes that will leave with the next ones"""

    def look(self, key: int) -> None:
        """Judge keyframes that are old enough at the newest one, `key`."""
        for k in range(self._next, key - OLD_AGE + 1):
            if self._is_spare(k):
                self._spare.append(k)
            self._next = k + 1
        # A loop may have been closed with some of them since they were judged.
        self._spare = [k for k in self._spare if k not in self._closings.own_keys]
        if len(self._spare) >= _BATCH:
            self._graph.take_out(self._spare)
            self._spare = []

    def _is_spare(self, k: int) -> bool:
        """Whether a keyframe and those that are linked to it are known by old ones, of which there are enough."""
        old_links, graph = self._graph.old_links, self._graph
        if any(len(old_links.get(j, ())) < _LEAST_OLD_LINKS for j in range(k, k + RECENT + 1)):
            return False
        if k in self._closings.own_keys:
            return False
        kept = graph.is_kept[:k].copy()
        kept[self._spare] = False
        off = graph.poses[:k][kept] - graph.poses[k]
        near = (np.hypot(off[:, 0], off[:, 1]) < _NEAR_M) & (np.abs(wrap_angle(off[:, 2])) < _NEAR_RAD)
        return bool(np.count_nonzero(near) >= _ENOUGH)
