"""Closings and thinning: which links close loops and are taken back, and which keyframes leave the graph."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sixthsense.slam.scans.graph import LINKS, OLD_AGE, PERIOD, ScanGraph
from sixthsense.slam.scans.links import Alignments
from sixthsense.slam.thinning import is_crowded

_CONTRADICTION = 60.0  # squared Mahalanobis distance of a link that contradicts the graph, 3 degrees of freedom


class Closings:
    """The loop closures so far. A link to an old keyframe belongs to the last of them, which made its pose known."""

    def __init__(self, graph: ScanGraph) -> None:
        self._graph = graph
        self._standing: list[int] = []
        self.accepted = 0
        """loop closures accepted so far"""

    @property
    def undone(self) -> int:
        """Loop closures taken back so far."""
        return self.accepted - len(self._standing)

    @property
    def latest(self) -> int:
        """Number of the last loop closure that stands; -1 for none."""
        return self._standing[-1] if self._standing else -1

    def close(self, found: Alignments) -> bool:
        """Close a loop with the links of a place; whether it stays closed.

        A loop closure that contradicts the graph, in the median of its links, is taken back, with all links that
        followed from it.
        """
        number = self.accepted
        self.accepted += 1
        self._standing.append(number)
        self._graph.give(found, np.ones(len(found.targets), dtype=np.bool_), number, closes=True)
        while self._standing:
            squares = self._contradictions()
            if max(squares) <= _CONTRADICTION:
                break
            self._undo(self._standing[int(np.argmax(squares))])
        return number in self._standing

    def _contradictions(self) -> list[float]:
        """Of each loop closure that stands: median squared distance from the estimate of the links that closed it."""
        links = self._graph.links
        own = links[links["closes"]]
        squares = self._graph.squares(own)
        of_each = (squares[own["closure"] == number] for number in self._standing)
        return [float(np.median(each)) if len(each) else 0.0 for each in of_each]

    def _undo(self, number: int) -> None:
        self._standing.remove(number)
        links = self._graph.links
        self._graph.remove(links[links["closure"] == number])


class Thinning:
    """Which keyframes leave the graph."""

    def __init__(self, graph: ScanGraph) -> None:
        self._graph = graph
        self._next = 1
        """the first keyframe that was not judged yet"""
        self._spare: list[int] = []
        """keyframes that will leave with the next ones"""

    def look(self, key: int) -> None:
        """Judge keyframes that are old enough at the newest one, `key`."""
        for k in range(self._next, key - OLD_AGE + 1):
            if self._is_spare(k, self._graph.old_links()):
                self._spare.append(k)
        self._next = max(self._next, key - OLD_AGE + 1)
        if len(self._spare) >= PERIOD:
            links = self._graph.links
            # A loop may have been closed with some of them since they were judged.
            leaving = sorted(set(self._spare) - set(links["ends"][links["closes"]].ravel().tolist()))
            self._spare = []
            if leaving:
                self._graph.take_out(leaving)

    def _is_spare(self, k: int, old_links: NDArray[np.int64]) -> bool:
        """Whether a keyframe and those that are linked to it have two links to old ones, and enough of these are near.

        `old_links` (K,) are the numbers of links of keyframes to old ones.
        """
        graph = self._graph
        if old_links[k : k + LINKS + 1].min() < 2:
            return False
        kept = graph.is_kept
        kept[self._spare] = False
        return is_crowded(graph.poses, kept, k)
