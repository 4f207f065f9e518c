"""Closing a loop: the links of a loop closure, how they are given to the estimator, and how they are taken back.

A loop that is off by metres cannot be closed with a loss that lets go of large residuals. The links of a new loop
closure are given as squares first, which distributes the error over the loop, and then with their loss. A loop closure
is undone if its own links contradict the graph then, or if it has made more other links contradict than it has.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from sixthsense.slam.scans.graph import OLD_LOSS, RECENT_GROUP, KeyframeLink, ScanGraph
from sixthsense.slam.scans.links import Alignments

_CONTRADICTION = 60.0  # squared Mahalanobis distance of a link that contradicts the graph, 3 degrees of freedom
_FIRST = -1  # the group of links before the first loop closure


class Closings:
    """The loop closures so far. A link to an old keyframe belongs to the last of them, which made its pose known."""

    def __init__(self, graph: ScanGraph) -> None:
        self._graph = graph
        self._own: dict[int, list[int]] = {_FIRST: []}
        """of each loop closure that stands: ids of the links that it was closed with"""
        self._latest = _FIRST
        self.accepted = 0
        """loop closures accepted so far"""
        self.undone = 0
        """loop closures taken back so far"""

    @property
    def links(self) -> list[KeyframeLink]:
        """Links to old keyframes."""
        return [link for link in self._graph.links.values() if link.group != RECENT_GROUP]

    @property
    def own_keys(self) -> set[int]:
        """Keyframes of the links that loops were closed with."""
        return {key for own in self._own.values() for link in self._of(own) for key in (link.target, link.source)}

    def link(self, key: int) -> None:
        """Link a new keyframe to those before it, and to old ones around those that they are linked to."""
        self._graph.link(key, self._graph.near_linked(key), self._latest)

    def link_old(self, key: int, targets: NDArray[np.int64]) -> None:
        """Link a keyframe to old ones near it."""
        if len(targets):
            self._graph.link_old(key, targets, self._latest)

    def close(self, links: list[tuple[Alignments, int]]) -> bool:
        """Close a loop with the links of a place, rows of alignments; whether it stays closed."""
        graph = self._graph
        self._latest = closure = self.accepted
        self.accepted += 1
        broken = self._broken(closure)
        ids = graph.with_loss(graph.give(links, np.inf, closure), OLD_LOSS)
        self._own[closure] = ids
        while contradicted := [g for g in self._own if self._contradiction(g) > _CONTRADICTION]:
            self._undo(max(contradicted, key=self._contradiction))
        if closure in self._own and self._broken(closure) - broken > len(links):
            self._undo(closure)
        return closure in self._own

    def _of(self, ids: list[int]) -> list[KeyframeLink]:
        return [self._graph.links[i] for i in ids]

    def _contradiction(self, g: int) -> float:
        """Median squared Mahalanobis distance from the estimate of the links that a loop was closed with."""
        own = self._of(self._own[g])
        return float(np.median(self._graph.squares(own))) if own else 0.0

    def _broken(self, newest: int) -> int:
        """How many links of all loop closures but the newest one contradict the estimate."""
        others = [link for link in self.links if link.group != newest]
        return int(np.count_nonzero(self._graph.squares(others) > _CONTRADICTION))

    def _undo(self, g: int) -> None:
        """Take back a loop closure and all links that followed from it."""
        del self._own[g]
        self._graph.remove([i for i, link in self._graph.links.items() if link.group == g])
        self.undone += 1
        if g == self._latest:
            self._latest = max(self._own)
